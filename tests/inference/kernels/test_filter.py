"""Every fast path against its readable twin, over many seeds, sizes and awkward likelihoods."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.evidence import counting
from egolane_pgm.graphs import sensor_failure
from egolane_pgm.inference import filtering
from egolane_pgm.inference.batch import confusions_many
from egolane_pgm.inference.compile import Compiled, compile_network, with_tables
from egolane_pgm.inference.kernels import filter as kernels
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.confusion import confusion, count_confusion
from egolane_pgm.types import TIE_TOLERANCE, Evidence, InputError, LineLog

#: Without the compiler everything is thousands of times slower, and one size is as good as ten.
IS_COMPILED = os.environ.get("NUMBA_DISABLE_JIT", "0") == "0"

#: Persistent nodes' sizes, groups' columns. Few, because each is compiled.
SIZES = [((4, 2), (4, 2)), ((3, 2), (3, 2)), ((4,), (4,)), ((1,), (1,)), ((2, 3), (5, 1, 2))]
SIZES = SIZES if IS_COMPILED else SIZES[:1]

METHODS = (False, True)


def random_rows(rng, *shape, zeros=0.0):
    values = rng.uniform(0.02, 1.0, shape) * (rng.uniform(size=shape) >= zeros)
    values[..., 0] += 1e-3
    return values / values.sum(axis=-1, keepdims=True)


def random_arguments(rng, nodes, columns, n_frames, *, is_factored, inputs=1, zeros=0.0):
    """Arguments of a filter, up to what it writes; evidence last, a block for each group."""
    n_states = int(np.prod(nodes))
    digits = np.indices(nodes).reshape(len(nodes), -1)
    start = np.concatenate([[0], np.cumsum(nodes)[:-1]])
    node_column = (digits + start[:, None]).astype(np.int64)
    group_start = np.concatenate([[0], np.cumsum(columns)]).astype(np.int64)
    emission = np.concatenate([random_rows(rng, n_states, k, zeros=zeros) for k in columns], axis=1)
    blocks = [random_rows(rng, n_frames, k, zeros=zeros) for k in columns]
    return {
        "joint": np.zeros(n_states),
        "is_first": True,
        "is_factored": is_factored,
        "prior": random_rows(rng, inputs, n_states),
        "transition": random_rows(rng, inputs, n_states, n_states, zeros=zeros),
        "input_index": rng.integers(0, inputs, n_frames),
        "emission": emission,
        "group_start": group_start,
        "evidence": blocks,
        "node_column": node_column,
        "n_persistent": len(nodes),
    }


def results_of(run, arguments, *, in_blocks):
    given = dict(arguments, joint=arguments["joint"].copy())
    blocks = given["evidence"]
    n_frames = len(blocks[0])
    if not in_blocks:
        given["evidence"] = np.concatenate(blocks, axis=1)
    n_columns = int(given["node_column"].max()) + 1
    # `filter_blocks` may be given anything to write to, the others need zeros.
    fill = np.full if in_blocks else lambda shape, _: np.zeros(shape)
    written = [
        fill((n_frames, n_columns), np.nan),
        fill(n_frames, np.nan),
        np.full(n_frames, in_blocks),
    ]
    with np.errstate(all="ignore"):  # the kernel itself, with the compiler switched off
        run(*given.values(), *written)
    return [given["joint"], *written]


def assert_all_agree(arguments):
    twin = results_of(filtering._filter_frames_numpy, arguments, in_blocks=False)
    plain = results_of(kernels.filter_frames, arguments, in_blocks=False)
    fast = results_of(kernels.filter_blocks, arguments, in_blocks=True)
    for name, a, b, c in zip(
        ("joint", "marginals", "log", "impossible"), twin, plain, fast, strict=True
    ):
        np.testing.assert_allclose(b, a, rtol=1e-12, atol=1e-12, err_msg=f"plain {name}")
        np.testing.assert_allclose(c, a, rtol=1e-12, atol=1e-12, err_msg=f"fast {name}")
    return twin


@pytest.fixture(autouse=True)
def use_written_out_kernels_for_short_sequences(monkeypatch):
    monkeypatch.setattr(kernels, "MIN_FRAMES", 4)


@pytest.mark.parametrize("is_factored", METHODS)
@pytest.mark.parametrize(("nodes", "columns"), SIZES)
def test_kernels_equal_the_numpy_twin(nodes, columns, is_factored):
    for seed in range(25 if IS_COMPILED else 3):
        rng = np.random.default_rng(seed)
        assert_all_agree(
            random_arguments(rng, nodes, columns, 40, is_factored=is_factored, zeros=seed % 3 * 0.2)
        )


@pytest.mark.parametrize("is_factored", METHODS)
def test_kernels_equal_the_twin_around_impossible_frames(is_factored):
    rng = np.random.default_rng(3)
    arguments = random_arguments(rng, (4, 2), (4, 2), 60, is_factored=is_factored)
    impossible = np.isin(np.arange(60), [0, 7, 8, 9, 10, 11, 30, 59])
    arguments["evidence"][0][impossible] = 0.0
    twin = assert_all_agree(arguments)
    assert np.array_equal(twin[-1], impossible)


@pytest.mark.parametrize("is_factored", METHODS)
@pytest.mark.parametrize("scale", [1e-200, 1e-130, 1e130, 1e200, 1e300])
def test_likelihoods_of_absurd_size_are_scaled_not_lost(scale, is_factored):
    rng = np.random.default_rng(4)
    arguments = random_arguments(rng, (4, 2), (4, 2), 40, is_factored=is_factored)
    before = assert_all_agree(arguments)
    for block in arguments["evidence"]:
        block[10:20] *= scale
    after = assert_all_agree(arguments)
    assert not after[-1].any()
    np.testing.assert_allclose(after[1], before[1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("is_factored", METHODS)
def test_hardly_possible_states_survive_small_likelihoods(is_factored):
    """A state of probability 1e-150 is all that is left once the others are ruled out."""
    rng = np.random.default_rng(14)
    arguments = random_arguments(rng, (4, 2), (4, 2), 40, is_factored=is_factored)
    arguments["transition"][:] = np.eye(8)
    arguments["emission"][:, :4] = np.repeat(np.eye(4), 2, axis=0)
    lanes = arguments["evidence"][0]
    lanes[5] = [1.0, 1.0, 1.0, 1e-150]
    lanes[6:12] *= 1e-120
    lanes[12] = [0.0, 0.0, 0.0, 1.0]
    twin = assert_all_agree(arguments)
    assert not twin[-1].any()
    np.testing.assert_allclose(twin[1][12:, 3], 1.0, rtol=0, atol=1e-12)


def test_small_likelihoods_over_many_frames_do_not_underflow():
    rng = np.random.default_rng(5)
    n_frames = 2000 if IS_COMPILED else 200
    arguments = random_arguments(rng, (4, 2), (4, 2), n_frames, is_factored=False)
    arguments["evidence"][0] *= 1e-9
    twin = assert_all_agree(arguments)
    assert twin[2].sum() < -20 * n_frames


@pytest.mark.parametrize("is_factored", METHODS)
def test_a_sequence_in_parts_equals_the_whole(is_factored):
    rng = np.random.default_rng(6)
    whole = random_arguments(rng, (4, 2), (4, 2), 50, is_factored=is_factored)
    _, marginals, log_evidence, _ = results_of(kernels.filter_blocks, whole, in_blocks=True)
    joint = whole["joint"]
    for begin, stop in pairwise([0, 6, 7, 30, 50]):
        part = dict(whole, joint=joint, is_first=begin == 0)
        part["input_index"] = whole["input_index"][begin:stop]
        part["evidence"] = [block[begin:stop] for block in whole["evidence"]]
        joint, m, e, _ = results_of(kernels.filter_blocks, part, in_blocks=True)
        np.testing.assert_allclose(m, marginals[begin:stop], rtol=0, atol=1e-12)
        np.testing.assert_allclose(e, log_evidence[begin:stop], rtol=0, atol=1e-12)


@pytest.mark.parametrize("is_factored", METHODS)
def test_networks_with_inputs_or_many_states_use_the_plain_kernel(is_factored):
    rng = np.random.default_rng(7)
    assert_all_agree(
        random_arguments(rng, (3, 2), (3, 2), 20, is_factored=is_factored, inputs=3, zeros=0.2)
    )
    large = random_arguments(rng, (5, 4), (5, 2), 20, is_factored=is_factored)
    size = kernels.kernel_size(large["group_start"], large["node_column"], 2, is_factored)
    assert not size.is_small
    assert_all_agree(large)


def test_logarithms_are_right_to_the_last_bits_over_the_whole_range():
    rng = np.random.default_rng(13)
    near_one = 1 + rng.uniform(-1e-6, 1e-6, 200)
    borders = np.array([1.0, 0.5**0.5, 2**0.5, 0.5, 2.0, 1e-250, 1e250])
    borders = np.concatenate([borders, np.nextafter(borders, 0), np.nextafter(borders, 1e300)])
    values = np.concatenate([np.exp(rng.uniform(-570, 570, 2000)), near_one, borders])
    expected = np.log(values)
    with np.errstate(over="ignore"):
        kernels.log_in_place(values)
    np.testing.assert_allclose(values, expected, rtol=4e-16, atol=0)


@pytest.mark.skipif(not IS_COMPILED, reason="nothing is compiled with NUMBA_DISABLE_JIT")
def test_a_second_process_loads_the_kernels_instead_of_compiling_them(tmp_path):
    program = """
import numpy as np
from egolane_pgm.inference.kernels import filter as kernels
size = kernels.Size((2,), ((0, 1),), 1, False)
run = kernels._filter_kernel(size)
square, frames = np.ones((2, 2)), np.ones((3, 2))
run(np.ones(2), np.ones(2), square, square, True, 0, 3, frames, np.ones(3), frames)
print(sum(run.stats.cache_hits.values()), sum(run.stats.cache_misses.values()))
"""
    environment = dict(os.environ, NUMBA_CACHE_DIR=str(tmp_path))
    said = [
        subprocess.run(
            [sys.executable, "-c", program],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for _ in range(2)
    ]
    assert said == [["0", "1"], ["1", "0"]]


@pytest.fixture(scope="module")
def models() -> list[Compiled]:
    """The paper's graph for three lanes with eleven parameter sets: more than one batch."""
    rng = np.random.default_rng(8)

    def tables(**given):
        return sensor_failure.tables(3, resolve_parameters(sensor_failure.PARAMETERS, given, 3))

    parameters = resolve_parameters(sensor_failure.PARAMETERS, {}, 3)
    model = compile_network(
        sensor_failure.build(3, parameters), sensor_failure.HIDDEN, sensor_failure.OBSERVED
    )
    names = ("p1", "p2", "p3", "p4")
    return [
        with_tables(
            model,
            tables(
                sigma1=rng.uniform(0.1, 1.0),
                sigma2=rng.uniform(0.1, 1.0),
                **dict(zip(names, rng.uniform(0.05, 0.95, 4), strict=True)),
            ),
        )
        for _ in range(11)
    ]


def random_evidence(rng, n_frames):
    detector = random_rows(rng, n_frames, 3)
    detector[rng.uniform(size=n_frames) < 0.2] = 1 / 3
    return Evidence({"DetectorOutput": detector, "WOR": random_rows(rng, n_frames, 2)})


def one_by_one(models, evidence, lane, is_crossing, method):
    return np.stack(
        [
            confusion(
                assigned_lane(
                    filtering.filter_beliefs(m, evidence, method, kernel=False).marginals["Lane"]
                ),
                lane,
                is_crossing,
                3,
            )
            for m in models
        ]
    )


@pytest.mark.parametrize("method", filtering.METHODS)
def test_many_parameter_sets_give_the_confusions_of_each_on_its_own(models, method):
    rng = np.random.default_rng(9)
    n_frames = 400 if IS_COMPILED else 40
    evidence = random_evidence(rng, n_frames)
    # A tie in the first frame, whose belief is the uniform prior times this: Unassigned.
    evidence.likelihoods["DetectorOutput"][0] = 1 / 3
    lane, is_crossing = rng.integers(1, 4, n_frames), rng.uniform(size=n_frames) < 0.1
    is_crossing[0] = False
    lane[is_crossing] = 99  # not looked at
    many = confusions_many(models, evidence, lane, is_crossing, method)
    assert np.array_equal(many, one_by_one(models, evidence, lane, is_crossing, method))
    assert (many[:, 3].sum(axis=1) >= 1).all()
    assert (many.sum(axis=(1, 2)) == (~is_crossing).sum()).all()


@pytest.mark.parametrize("method", filtering.METHODS)
@pytest.mark.parametrize("factor", [0.0, 1e-300, 1e300])
def test_many_parameter_sets_agree_where_a_likelihood_is_out_of_range(models, factor, method):
    rng = np.random.default_rng(10)
    evidence = random_evidence(rng, 60)
    evidence.likelihoods["DetectorOutput"][20] *= factor
    evidence.likelihoods["WOR"][20] *= factor
    lane, is_crossing = rng.integers(1, 4, 60), np.zeros(60, dtype=bool)
    many = confusions_many(models, evidence, lane, is_crossing, method)
    assert np.array_equal(many, one_by_one(models, evidence, lane, is_crossing, method))


def test_many_parameter_sets_of_one_frame_and_of_none(models):
    rng = np.random.default_rng(11)
    evidence = random_evidence(rng, 1)
    lane, is_crossing = np.array([2]), np.array([False])
    many = confusions_many(models, evidence, lane, is_crossing)
    assert np.array_equal(many, one_by_one(models, evidence, lane, is_crossing, "assumed_density"))
    with pytest.raises(InputError, match="at least one"):
        confusions_many([], evidence, lane, is_crossing)


def test_confusions_of_many_refuse_bad_input_by_name(models):
    evidence = random_evidence(np.random.default_rng(12), 5)
    lane, none = np.ones(5, dtype=np.int64), np.zeros(5, dtype=bool)
    with pytest.raises(InputError, match=r"filter 'exakt' \(did you mean 'exact'"):
        confusions_many(models, evidence, lane, none, "exakt")
    with pytest.raises(InputError, match=r"'Lanes' is not a hidden one \(did you mean 'Lane'"):
        confusions_many(models, evidence, lane, none, node="Lanes")
    with pytest.raises(InputError, match=r"row 2 has lane 4, outside 1\.\.3"):
        confusions_many(models, evidence, np.array([1, 1, 4, 1, 1]), none)
    with pytest.raises(InputError, match=r"truth_lane has shape \(4,\), needs \(5,\)"):
        confusions_many(models, evidence, lane[:4], none)
    parameters = resolve_parameters(sensor_failure.PARAMETERS, {}, 2)
    other = compile_network(
        sensor_failure.build(2, parameters), sensor_failure.HIDDEN, sensor_failure.OBSERVED
    )
    with pytest.raises(InputError, match="differ in structure"):
        confusions_many([models[0], other], evidence, lane, none)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
def test_one_pass_confusion_equals_assign_then_confusion(seed, n_lanes):
    rng = np.random.default_rng(seed)
    # Few distinct values, so that ties, within and just outside the tolerance, are frequent.
    near = np.array([0.0, 0.25, 0.5, 0.5 * (1 - 1e-10), 0.5 * (1 - 1e-8)])
    belief = rng.choice(near, (50, n_lanes))
    lane, is_crossing = rng.integers(1, n_lanes + 1, 50), rng.uniform(size=50) < 0.2
    counts = np.zeros((n_lanes + 1, n_lanes), dtype=np.int64)
    count_confusion(belief, lane, is_crossing, TIE_TOLERANCE, counts)
    expected = confusion(assigned_lane(belief), lane, is_crossing, n_lanes)
    assert np.array_equal(counts, expected)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.booleans())
def test_counting_kernel_equals_its_numpy_twin(seed, n_lanes, ignore):
    rng = np.random.default_rng(seed)
    shape = (30, 5)
    on_border = rng.choice([-7.0, -3.5, 0.0, 3.5, 7.0, 10.5], shape)
    offset = np.where(rng.uniform(size=shape) < 0.3, on_border, rng.normal(0, 6, shape))
    valid = rng.uniform(size=shape) < 0.6
    offset[~valid & (rng.uniform(size=shape) < 0.5)] = np.nan
    lri = np.where(rng.uniform(size=shape) < 0.1, np.nan, rng.integers(-1, 12, shape))
    ids = np.arange(30)
    log = LineLog(ids, ids / 10, offset, valid, rng.uniform(size=shape) < 0.5, lri)
    parameters = resolve_parameters(
        counting.PARAMETERS,
        {"bonus_value": rng.uniform(0, 9), "no_valid_line": "ignore" if ignore else "uniform"},
        n_lanes,
    )
    fast = counting.evidence(log, n_lanes, parameters)
    twin = counting.evidence(log, n_lanes, parameters, kernel=False)
    for key in counting.PROVIDES:
        np.testing.assert_allclose(fast.likelihoods[key], twin.likelihoods[key], rtol=0, atol=1e-12)
