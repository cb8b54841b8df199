"""Source text of filter kernels with all loops over states written out, for one size each.

A filter over 8 states spends most of its time on loop counters and on stores that the next line
loads again. With sizes known the states live in registers and a frame costs a fraction. Nothing
here knows numba: `kernels` compiles what these functions write, and `filter_frames` there is the
readable version of the same recursion.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

#: Larger networks stay with the plain kernel: what is written out grows with the states' square.
MAX_STATES = 16
MAX_COLUMNS = 24

#: A frame whose likelihood is outside of this range is left to the plain kernel.
TINY, HUGE = 1e-250, 1e250

#: The carried belief is brought back to a sum of one when its sum leaves this range, before the
#: states that hardly count are lost (a product of marginals has this sum to some power).
LOW, HIGH = 1e-30, 1e30

#: Vector registers hold this many numbers; the states are padded with zeros to a multiple.
WIDTH = 4

#: Parameter sets that `confusion_source` filters side by side.
BATCH = 8


class Size(NamedTuple):
    """What a kernel is written for.

    sizes: the columns of each emission group. node_column: per hidden node the column of the
    marginals that each joint state adds to, persistent nodes first; n_persistent of them.
    is_factored: the product of the marginals is carried on, not the joint belief.
    """

    sizes: tuple[int, ...]
    node_column: tuple[tuple[int, ...], ...]
    n_persistent: int
    is_factored: bool

    @property
    def n_states(self) -> int:
        """Joint states."""
        return len(self.node_column[0])

    @property
    def n_rows(self) -> int:
        """Rows of the tables: the transition's, then one for each evidence column."""
        return self.n_states + sum(self.sizes)

    @property
    def is_small(self) -> bool:
        """Whether writing it out is sensible."""
        return self.n_states <= MAX_STATES and sum(self.sizes) <= MAX_COLUMNS


def padded(n_states: int) -> int:
    """The number of states, rounded up to whole vectors."""
    return -(-n_states // WIDTH) * WIDTH


def filter_source(name: str, size: Size) -> str:
    """`name(joint, prior, transition, emission, is_first, first, last, marginals, total, *blocks)`:
    filter the frames from `first` to before `last`.

    joint (S,): the belief after the frame before; becomes that after the last one. is_first: there
    is none, the first frame takes prior (S,). transition (S, S), emission (S, K), the groups side
    by side. blocks: per group its evidence (T, K). Written: marginals (T, M), total (T,), the
    likelihood of each frame given those before.
    Returns `last`, or a frame that the plain kernel has to do; then joint is as it was.
    """
    n_states = size.n_states
    states = range(n_states)
    width = padded(n_states)
    end = size.n_rows * width
    blocks = [f"block{g}" for g in range(len(size.sizes))]
    likelihood = " * ".join(_likelihoods(size, lambda row: f"work[{row * width} + s]"))
    predicted = _balanced([f"j{r} * work[{r * width} + s]" for r in states])
    arrays = ["marginals", "total", *blocks]
    flat = ", ".join(arrays)
    slices = ", ".join(f"{array}[first:last].ravel()" for array in arrays)
    head = f"""
def {name}(
    joint, prior, transition, emission, is_first, first, last, marginals, total, {", ".join(blocks)}
):
    # One array for what is read and written in the loop over states: the compiler sees that the
    # parts do not overlap. Rows of a vector's width: transition, emission, what is carried.
    work = np.zeros({end + width})
    for s in range({n_states}):
        for k in range({size.n_rows - n_states}):
            work[({n_states} + k) * {width} + s] = emission[s, k]
        work[{end} + s] = prior[s] if is_first else joint[s]
    {flat} = ({slices})
    # One over what the carried numbers sum to.
    scale = 1.0
    # Before the first frame of all nothing moves.
    n_still = 1 if is_first else 0
    for part in range(2):
        for r in range({n_states}):
            for s in range({n_states}):
                still = 1.0 if r == s else 0.0
                work[r * {width} + s] = transition[r, s] if part == 1 else still
        begin, stop = (n_still, last - first) if part == 1 else (0, n_still)
        for t in range(begin, stop):
"""
    body = [
        *_load_evidence(size),
        *(f"j{s} = work[{end + s}]" for s in states),
        f"for s in range({width}):",
        f"    work[{end} + s] = {predicted} * ({likelihood}{' * scale' * size.is_factored})",
        *(f"w{s} = work[{end + s}]" for s in states),
        *_marginals(size),
        f"mass = {_balanced([f'm{c}' for c in _columns_of_last_persistent(size)])}",
        "inverse = 1.0 / mass",
        *(
            f"marginals[t * {_n_columns(size)} + {c}] = m{c} * inverse"
            for c in range(_n_columns(size))
        ),
    ]
    # The carried sum is put right only now and then: the division is not waited for in each frame.
    if size.is_factored:
        body += [
            "total[t] = mass",
            *(f"work[{end + s}] = {_product(size, s)}" for s in states),
            f"scale = {' * '.join(['inverse'] * size.n_persistent)}",
            f"if not {LOW} < mass < {HIGH}:",
            f"    if not {TINY} < mass < {HUGE}:",
            "        return first + t",
            *(f"    n{c} = m{c} * inverse" for c in _persistent_columns(size)),
            *(f"    work[{end + s}] = {_product(size, s, 'n{}')}" for s in states),
            "    scale = 1.0",
        ]
    else:
        body += [
            "likelihood = mass * scale",
            "total[t] = likelihood",
            "scale = inverse",
            f"if not {LOW} < mass < {HIGH}:",
            f"    if not {TINY} < likelihood < {HUGE}:",
            "        return first + t",
            *(f"    work[{end + s}] *= inverse" for s in states),
            "    scale = 1.0",
        ]
    lines = [
        *(f"            {line}" for line in body),
        *(f"    joint[{s}] = work[{end + s}] * scale" for s in states),
        "    return last",
    ]
    return head + "\n".join(lines) + "\n"


def confusion_source(name: str, size: Size, lanes: tuple[int, ...]) -> str:
    """`name(joint, tables, first, column, tolerance, counts, *blocks)`: BATCH sets at once.

    joint (S, BATCH): after the frame before `first`, overwritten. tables (rows * S * BATCH,):
    flat, the sets last, rows as in Size.n_rows. column (T,): the true lane's index, -1 where a
    frame is not scored. lanes: the columns of the marginals that are Lane's. counts
    (BATCH, n + 1, n): the confusions, added to; the row is the most probable lane, or n where the
    runner-up is within `tolerance`.
    Returns whether every frame had a likelihood in range; else the counts mean nothing.
    """
    states = range(size.n_states)
    n_lanes = len(lanes)
    blocks = [f"block{g}" for g in range(len(size.sizes))]

    def table(row: int, s: int) -> str:
        return f"tables[{(row * size.n_states + s) * BATCH} + b]"

    def work(slot: int) -> str:
        return f"work[{slot * BATCH} + b]"

    smallest, largest = size.n_states + n_lanes, size.n_states + n_lanes + 1
    filtering = [f"j{s} = {work(s)}" for s in states]
    for s in states:
        terms = " * ".join(_likelihoods(size, lambda row, s=s: table(row, s)))  # type: ignore[misc]
        predicted = _balanced([f"j{r} * {table(r, s)}" for r in states])
        filtering.append(f"w{s} = {predicted} * ({terms})")
    filtering += [
        *_marginals(size),
        f"mass = {_balanced([f'm{c}' for c in _columns_of_last_persistent(size)])}",
        "inverse = 1.0 / mass",
        f"{work(smallest)} = min({work(smallest)}, mass)",
        f"{work(largest)} = max({work(largest)}, mass)",
    ]
    if size.is_factored:
        filtering += [f"n{c} = m{c} * inverse" for c in _persistent_columns(size)]
        filtering += [f"{work(s)} = {_product(size, s, 'n{}')}" for s in states]
    else:
        filtering += [f"{work(s)} = w{s} * inverse" for s in states]
    filtering += [f"{work(size.n_states + k)} = m{c}" for k, c in enumerate(lanes)]

    top = "m0"
    for k in range(1, n_lanes):
        top = f"max({top}, m{k})"
    scoring = [
        *(f"m{k} = {work(size.n_states + k)}" for k in range(n_lanes)),
        f"top = {top}",
        "bound = top - tolerance * top",
        *(f"near{k} = 1.0 if m{k} >= bound else 0.0" for k in range(n_lanes)),
        f"row = {' + '.join(f'{k}.0 * near{k}' for k in range(n_lanes))}",
        f"rows[b] = row if {' + '.join(f'near{k}' for k in range(n_lanes))} == 1.0"
        f" else {n_lanes}.0",
    ]
    lines = [
        f"def {name}(joint, tables, first, column, tolerance, counts, {', '.join(blocks)}):",
        # Known to be a multiple of the vector's width, but not written out.
        f"    n = joint.shape[1] // {WIDTH} * {WIDTH}",
        f"    work = np.ones({(size.n_states + n_lanes + 2) * BATCH})",
        f"    rows = np.empty({BATCH})",
        f"    for s in range({size.n_states}):",
        f"        for b in range({BATCH}):",
        f"            work[s * {BATCH} + b] = joint[s, b]",
        "    column = column[first:]",
        *(f"    {array} = {array}[first:].ravel()" for array in blocks),
        "    for t in range(column.shape[0]):",
        *(f"        {line}" for line in _load_evidence(size)),
        "        for b in range(n):",
        *(f"            {line}" for line in filtering),
        "        if column[t] < 0:",
        "            continue",
        "        for b in range(n):",
        *(f"            {line}" for line in scoring),
        f"        for b in range({BATCH}):",
        "            counts[b, int(rows[b]), column[t]] += 1",
        f"    for b in range({BATCH}):",
        # NaN is not equal to itself, and once there it stays in the carried belief.
        f"        for s in range({size.n_states}):",
        f"            joint[s, b] = work[s * {BATCH} + b]",
        f"        if not ({TINY} < {work(smallest)} and {work(largest)} < {HUGE}"
        f" and {work(0)} == {work(0)}):",
        "            return False",
        "    return True",
    ]
    return "\n".join(lines) + "\n"


def _load_evidence(size: Size) -> list[str]:
    """The blocks are flat: with the row's length known its start costs nothing."""
    return [
        f"e{g}_{k} = block{g}[t * {n} + {k}]" for g, n in enumerate(size.sizes) for k in range(n)
    ]


def _likelihoods(size: Size, table: Callable[[int], str]) -> list[str]:
    """Per group the likelihood of a state; `table(row)` is that state's entry."""
    terms = []
    row = size.n_states
    for g, n_columns in enumerate(size.sizes):
        products = [f"{table(row + k)} * e{g}_{k}" for k in range(n_columns)]
        terms.append(f"({' + '.join(products)})")
        row += n_columns
    return terms


def _balanced(terms: list[str]) -> str:
    """Their sum in two halves, which the processor adds up side by side."""
    if len(terms) < 3:
        return f"({' + '.join(terms)})"
    return f"(({' + '.join(terms[::2])}) + ({' + '.join(terms[1::2])}))"


def _marginals(size: Size) -> list[str]:
    lines = []
    for c in range(_n_columns(size)):
        terms = [f"w{s}" for row in size.node_column for s, at in enumerate(row) if at == c]
        lines.append(f"m{c} = {_balanced(terms) if terms else '0.0'}")
    return lines


def _n_columns(size: Size) -> int:
    return 1 + max(c for row in size.node_column for c in row)


def _persistent_columns(size: Size) -> list[int]:
    return sorted({c for row in size.node_column[: size.n_persistent] for c in row})


def _columns_of_last_persistent(size: Size) -> list[int]:
    """Their marginals sum to what all states sum to."""
    return sorted(set(size.node_column[size.n_persistent - 1]))


def _product(size: Size, state: int, marginal: str = "m{}") -> str:
    """The product of a state's marginals; `marginal` is how that of a column is written."""
    return " * ".join(marginal.format(row[state]) for row in size.node_column[: size.n_persistent])
