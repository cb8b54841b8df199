"""Lines as evidence of the place on the road: kernel, twin and the formula in plain loops."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from itertools import product as product_of
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from egolane_pgm.evidence import line_geometry
from egolane_pgm.evidence.line_geometry import kernels
from egolane_pgm.evidence.line_geometry.model import (
    CLUTTER_PER_M,
    GENERIC,
    LANE_M,
    TABLE_STEP_M,
    line_model,
    places,
)
from egolane_pgm.evidence.line_geometry.reading import SeenLines, read_lines
from egolane_pgm.evidence.line_geometry.rule import NODES
from egolane_pgm.evidence.line_geometry.scale import line_classes
from egolane_pgm.evidence.line_geometry.visibility import (
    new_patterns,
    new_visibility,
    visibility_models,
    visibility_tables,
)
from egolane_pgm.graphs import position_in_lane
from egolane_pgm.parameters import Parameters
from egolane_pgm.recordings.table import write_table
from egolane_pgm.simulation import simulate
from egolane_pgm.types import Evidence, InputError, LineLog
from tests.conftest import needs_compiler
from tests.kits import line_logs
from tests.kits.drives import run, short_drive
from tests.kits.line_logs import line_log
from tests.kits.strangers import scale_changes, scaled
from tests.reference import line_geometry as reference

W = 3.6
#: The first value of LineMotion without a displacement.
UNSEEN = 99


def resolved(n_lanes: int = 3, **given: object) -> Parameters:
    return line_logs.resolved(n_lanes, **{"lane_width_m": W, **given})


def random_log(seed: int, n_frames: int = 40) -> LineLog:
    """Anything that a detector may say: gaps, held lines, placeholders, far and garbage offsets."""
    rng = np.random.default_rng(seed)
    shape = (n_frames, 5)
    offset = rng.uniform(-9, 9, shape)
    valid = rng.random(shape) < 0.7
    lri = rng.integers(-1, 11, shape).astype(float)
    held = rng.random(shape) < 0.3
    for t in range(1, n_frames):
        offset[t, held[t]] = offset[t - 1, held[t]]
    offset[rng.random(shape) < 0.05] = 0.0
    offset[rng.random(shape) < 0.05] = 40.0
    offset[~valid & (rng.random(shape) < 0.3)] = np.nan
    offset[~valid & (rng.random(shape) < 0.1)] = 3e32
    lri[rng.random(shape) < 0.1] = np.nan
    return line_log(
        offset,
        frame_id=np.cumsum(rng.choice([1, 1, 1, 2, 9], n_frames)),
        is_valid=valid,
        is_continuous=rng.random(shape) < 0.3,
        lri=lri,
        is_missing=rng.random(n_frames) < 0.1,
    )


def by_the_formula(
    lines: list[tuple[float, int]], n: int, parameters: Parameters, widths: Sequence[float] = (W,)
) -> np.ndarray:
    """One frame, (n cells, 2), from the intensities themselves: their mean over the lane widths, to
    which offsets are relative."""
    models = visibility_models(n, parameters)
    expected = np.array([model.expected for model in models])
    width = LANE_M
    place = places(models[0], width)
    cells = int(parameters["cells"])  # type: ignore[call-overload]
    alpha, beta = float(parameters["alpha"]), float(parameters["beta"])  # type: ignore[arg-type]
    result = np.empty((n * cells, 2))
    for u in range(cells):
        in_lane = ((u + 0.5) / cells - 0.5) * width
        p, mean = np.zeros((len(models), n)), 0.0
        for of_width in widths:
            product, of_mean = np.ones((len(models), n)), 1.0
            for offset, c in lines:
                intensity = np.empty((len(models), n))
                for (m, model), lane in product_of(enumerate(models), range(n)):
                    intensity[m, lane] = model.clutter[c]
                    for k in range(n + 3):
                        z = offset * width / of_width + in_lane - place[lane, k]
                        sigma = math.hypot(model.sigmas_m[k], model.sigma_per_m * place[lane, k])
                        z /= sigma
                        normal = math.exp(-0.5 * z**2) / (sigma * math.sqrt(2 * math.pi))
                        rate = model.rates[lane, k] * model.class_shares[k, c]
                        intensity[m, lane] += rate * normal
                product *= intensity
                of_mean *= intensity.mean()
            p += product / len(widths)
            mean += of_mean / len(widths)
        known = np.log(p) - expected - math.log(mean) + expected.mean()
        # Before the first frame, all kinds are equally probable.
        of_lane = np.log(np.exp(alpha * known).mean(axis=0))
        for lane in range(n):
            bad = beta * (math.log(mean) - expected.mean())
            result[lane * cells + u] = bad + of_lane[lane], bad
    return np.exp(result - result.max())


@pytest.mark.parametrize("clutter", ["generic", CLUTTER_PER_M.tolist()])
def test_the_likelihood_is_the_formula(clutter: str | list[float]) -> None:
    offsets = [-1.9, 1.6, 5.3, -5.2]
    log = line_log(
        [offsets],
        is_valid=[[True, True, True, False]],
        is_continuous=[[True, False, False, False]],
        lri=[[9.0, 6.0, 5.0, 3.0]],
    )
    parameters = resolved(alpha=0.3, beta=0.7, clutter=clutter)
    right = by_the_formula(list(zip(offsets, [0, 1, 2, 3], strict=True)), 3, parameters)
    for evidence in (line_geometry.evidence, reference.evidence):
        ours = evidence(log, 3, parameters).likelihoods[NODES][0]
        # The tables are interpolated between points 2 cm apart.
        np.testing.assert_allclose(np.log(ours), np.log(right), atol=5e-3)
        assert ours.max() == 1


@pytest.mark.parametrize(
    "widths", [(3.0, 3.3, 4.2), (3.6, 3.6, 3.6), (3.3, 3.3, 4.2), (3.3, 4.2, 4.2), (0.01, 2.0, 1e4)]
)
def test_over_several_widths_the_likelihood_is_the_mean(widths: tuple[float, ...]) -> None:
    offsets, kinds = [-1.9, 1.6, 5.3, -5.2, 9.9], [0, 1, 2, 3, -1]
    parameters = resolved(alpha=0.3, beta=0.7, clutter=CLUTTER_PER_M.tolist())
    lines = list(zip(offsets[:4], kinds[:4], strict=True))
    right = by_the_formula(lines, 3, parameters, widths)
    tables = visibility_tables(visibility_models(3, parameters), has_flags=True)
    for module in (kernels, reference):
        likelihood = np.empty((1, 48, 2))
        module.weigh_positions(
            *(np.array([offsets]), np.array([kinds]), np.array([widths])),
            *(tables.log_intensity, tables.log_mean, tables.first_m, TABLE_STEP_M, tables.expected),
            *(tables.width_m, 0.3, 0.7, np.ones(1), np.zeros(1, dtype=bool), 0.0, 0.0),
            *(new_visibility(3, 1), new_patterns(), likelihood, np.empty(1)),
        )
        np.testing.assert_allclose(np.log(likelihood[0]), np.log(right), atol=5e-3)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n_lanes=st.integers(1, 5),
    width=st.sampled_from([2.0, 3.6, "auto", "causal"]),
)
def test_the_kernel_equals_its_twin(seed: int, n_lanes: int, width: object) -> None:
    log, parameters = random_log(seed), resolved(n_lanes, lane_width_m=width)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ours = line_geometry.evidence(log, n_lanes, parameters)
        twin = reference.evidence(log, n_lanes, parameters)
    assert ours.likelihoods[NODES].shape == (len(log), 16 * n_lanes, 2)
    np.testing.assert_allclose(ours.likelihoods[NODES], twin.likelihoods[NODES], atol=1e-11)
    np.testing.assert_array_equal(ours.inputs["LineMotion"], twin.inputs["LineMotion"])
    assert (ours.likelihoods[NODES].max(axis=(1, 2)) == 1).all()


@pytest.mark.filterwarnings("ignore:line log")
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_mirrored_lines_give_the_mirrored_evidence(seed: int) -> None:
    log = random_log(seed)
    with np.errstate(invalid="ignore"):
        other = line_log(
            -log.offset_m,
            frame_id=log.frame_id,
            is_valid=log.is_valid,
            is_continuous=log.is_continuous,
            lri=log.lri,
            is_missing=log.is_missing,
        )
    # A road of equal shoulders, and an odd number of bins about zero.
    rates = line_model(3, resolved()).rates.copy()
    rates[:, -2:] = 0.1
    parameters = resolved(rates=rates)
    here = line_geometry.evidence(log, 3, parameters)
    there = line_geometry.evidence(other, 3, parameters)
    # The tables' points are not the same on both sides of zero.
    np.testing.assert_allclose(
        there.likelihoods[NODES][:, ::-1], here.likelihoods[NODES], atol=2e-3
    )
    motion, mirrored = here.inputs["LineMotion"], there.inputs["LineMotion"]
    gap = motion >= UNSEEN
    assert gap.any()
    np.testing.assert_array_equal(mirrored >= UNSEEN, gap)
    np.testing.assert_allclose(mirrored[~gap], 48 - motion[~gap], atol=1)
    n = len(position_in_lane.COASTING)
    (passed, there_passed), (coasting, there_coasting) = (
        (f(motion[gap] - UNSEEN, n), f(mirrored[gap] - UNSEEN, n))
        for f in (np.floor_divide, np.mod)
    )
    np.testing.assert_array_equal(there_passed, passed)
    np.testing.assert_array_equal(there_coasting, n - 1 - coasting)


@pytest.mark.parametrize(
    ("offset", "valid", "continuous", "lri", "kind"),
    [
        (1.8, True, True, 2, 0),
        (1.8, True, False, 6, 1),
        (1.8, True, False, math.nan, 1),
        (1.8, True, False, 5, 2),
        (1.8, False, True, 3, 3),
        (1.8, False, False, 2, -1),
        (1.8, False, False, math.nan, 3),
        (0.0, True, False, 10, -1),
        (-5e-7, True, False, 10, -1),
        (16.4, True, False, 10, 1),
        (16.5, True, False, 10, -1),
        (3e32, False, False, 10, -1),
        (math.nan, False, False, 10, -1),
    ],
)
def test_the_class_of_a_line(
    offset: float, valid: bool, continuous: bool, lri: float, kind: int
) -> None:
    log = line_log([[offset]], is_valid=[[valid]], is_continuous=[[continuous]], lri=[[lri]])
    assert seen_lines(log).kind.tolist() == [[kind]]
    _, is_strong = line_classes(log.offset_m, log.is_valid, log.is_continuous, log.lri)
    # How far is too far depends on the lane width, which the strong lines tell.
    is_too_far = abs(offset) > 16
    assert is_strong.tolist() == [[valid and not lri < 6 and (kind >= 0 or is_too_far)]]


def seen_lines(log: LineLog) -> SeenLines:
    kind, _ = line_classes(log.offset_m, log.is_valid, log.is_continuous, log.lri)
    widths = np.full(len(log), W)
    seen, _ = read_lines(log, kind, widths, repeats_are_held=False)
    return seen


def motion_of(log: LineLog) -> list[int]:
    seen = seen_lines(log)
    others = np.zeros(len(log), dtype=bool)
    index = position_in_lane.motion_index(
        seen.displacement, seen.ticks, seen.velocity, others, resolved()
    )
    return index.tolist()


def value_of(displacement_m: float, ticks: int = 1, velocity_m: float = 0.0) -> int:
    index = position_in_lane.motion_index(
        *(np.array([displacement_m / W]), np.array([ticks]), np.array([velocity_m / W])),
        *(np.zeros(1, dtype=bool), resolved()),
    )
    return int(index[0])


#: The value without a displacement, of lines that stood still.
LOST = value_of(math.nan)


def test_the_motion_is_the_median_of_the_matched_lines() -> None:
    log = line_log([[-1.8, 1.8, 5.4], [-1.7, 1.92, 5.8]])
    assert motion_of(log) == [LOST, value_of(0.12)]


def test_a_held_line_is_no_evidence_and_is_not_followed() -> None:
    """The left line moves; the right one is held: same offset, its LRI falls."""
    offsets = [[-1.8, 1.8], [-1.7, 1.8], [-1.6, 1.8]]
    log = line_log(offsets, lri=[[10, 10], [10, 9], [10, 8]])
    assert motion_of(log) == [LOST, value_of(0.1), value_of(0.1)]
    assert seen_lines(log).kind.tolist() == [[1, 1], [1, -1], [1, -1]]


def test_a_line_that_stands_still_with_a_steady_index_is_measured() -> None:
    assert motion_of(line_log([[-1.8, 1.8]] * 3)) == [LOST, value_of(0), value_of(0)]


def test_a_line_that_was_held_gives_the_motion_if_no_other_does() -> None:
    log = line_log([[1.8], [1.8], [1.4]], lri=[[10], [9], [10]])
    assert motion_of(log) == [LOST, LOST, value_of(-0.4)]


def test_nothing_is_matched_beyond_reach_or_across_a_gap() -> None:
    assert motion_of(line_log([[1.0], [2.0]])) == [LOST, LOST]
    gap = motion_of(line_log([[1.8], [1.7]], frame_id=[10, 14]))
    assert gap == [LOST, value_of(math.nan, 4)]
    assert gap[1] > LOST >= UNSEEN
    put_in = line_log([[1.8], [math.nan], [1.8]], is_missing=[False, True, False])
    assert motion_of(put_in) == [LOST] * 3


def test_lines_that_are_lost_go_on_as_they_moved_of_late() -> None:
    """One frame counts a tenth of the velocity, which fades by a hundredth in each frame."""
    offset = np.array([1.7 - 0.2 * t for t in range(20)] + [math.nan] * 5)[:, None]
    moving = value_of(-0.2)
    velocity = -0.2 * (1 - 0.9**19)
    lost = [value_of(math.nan, 1, velocity * 0.99**k) for k in range(5)]
    assert motion_of(line_log(offset)) == [LOST] + [moving] * 19 + lost
    assert lost[0] < LOST - 4
    # A displacement that is out of range is none.
    leaping = np.where(np.arange(25) % 2, 9.0, -9.0)[:, None]
    assert motion_of(line_log(np.where(np.isnan(offset), leaping, offset)))[20:] == lost
    ids = np.arange(25)
    ids[20:] += 7
    after_gap = motion_of(line_log(offset, frame_id=ids))[20:]
    assert after_gap[0] == value_of(math.nan, 8, velocity) > LOST
    assert after_gap[1:] == [value_of(math.nan, 1, velocity * 0.99 ** (8 + k)) for k in range(4)]
    # Frames that were put in are frames without lines.
    missing = np.arange(25) >= 20
    assert motion_of(line_log(offset, is_missing=missing))[20:] == lost


@pytest.mark.parametrize("n_slots", [0, 2])
def test_frames_without_lines_tell_no_place_inside_the_lane(n_slots: int) -> None:
    with pytest.warns(UserWarning, match="no two lines in one frame"):
        given = line_geometry.evidence(
            line_log(np.full((3, n_slots), math.nan)), 3, resolved(lane_width_m="auto")
        )
    by_cell = given.likelihoods[NODES].reshape(3, 3, 16, 2)
    np.testing.assert_allclose(by_cell.std(axis=2), 0, atol=1e-12)
    assert given.inputs["LineMotion"].tolist() == [LOST] * 3


@pytest.mark.filterwarnings("ignore:line log")
def test_a_detector_without_flags_is_taken_for_one_that_cannot_tell() -> None:
    """The own lane's lines, of a detector with flags that sees none: hardly the outer lane."""
    lines = [[-W / 2, W / 2, 1.5 * W]]
    shares = line_model(3, resolved(), replace(GENERIC, edge_continuous=0.95)).class_shares
    parameters = resolved(class_shares=shares, alpha=1)
    cannot_tell = line_log(lines * 2)
    can_tell = line_log(lines * 2, is_continuous=[[False] * 3, [False, False, True]])
    shares = []
    for log in (cannot_tell, can_tell):
        given = line_geometry.evidence(log, 3, parameters).likelihoods[NODES][0, :, 0]
        lane = given.reshape(3, 16).sum(axis=1)
        shares.append(lane[0] / lane.sum())
    assert shares[0] > shares[1] + 0.02


def causal_drive(kind: str) -> LineLog:
    """A drive whose lines change how they are read as it goes on."""
    log = simulate("quickstart", seed=4, frames=650).log
    log = log.take(np.delete(np.arange(650), [60, 61, 300]))
    late = np.arange(len(log))[:, None] >= 330
    if kind == "doubled":
        return replace(
            log,
            offset_m=np.concatenate([log.offset_m, log.offset_m + 0.1], axis=1),
            is_valid=np.concatenate([log.is_valid, log.is_valid & late], axis=1),
            is_continuous=np.tile(log.is_continuous, 2),
            lri=np.concatenate([log.lri, np.where(late, log.lri, np.nan)], axis=1),
        )
    if kind == "hardly a flag":
        flags = np.zeros(log.offset_m.shape, dtype=bool)
        flags[[150, 399], 0] = True
        return replace(log, is_continuous=flags & log.is_valid, lri=np.full(log.lri.shape, np.nan))
    return log


@pytest.mark.parametrize("kind", ["plain", "doubled", "hardly a flag"])
def test_one_frame_after_the_other_is_the_same_as_the_causal_whole(kind: str) -> None:
    log = causal_drive(kind)
    parameters = resolved(lane_width_m="causal")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        whole = line_geometry.evidence(log, 3, parameters)
    # The flag semantics change after 200 frames, inside a chunk of two.
    pairs = [0, *range(1, len(log), 2), len(log)]
    odd = [0, 1, 2, 3, 10, 11, *range(12, len(log), 137), len(log)]
    for cuts in (range(len(log) + 1), pairs, odd):
        give = line_geometry.online(3, parameters)
        parts = [give(log.take(slice(a, b))) for a, b in pairwise(cuts)]
        motion = np.concatenate([p.inputs["LineMotion"] for p in parts])
        np.testing.assert_array_equal(motion, whole.inputs["LineMotion"])
        ours = np.concatenate([p.likelihoods[NODES] for p in parts])
        np.testing.assert_array_equal(ours, whole.likelihoods[NODES])


def narrow(log: LineLog) -> LineLog:
    """Without the empty slots that are last in all frames."""
    is_used = (np.isfinite(log.offset_m) | log.is_valid).any(axis=0)
    n = len(is_used) - int(np.argmax(is_used[::-1])) if is_used.any() else 0
    names = ("offset_m", "is_valid", "is_continuous", "lri")
    return replace(log, **{name: getattr(log, name)[:, :n] for name in names})


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), width=st.sampled_from([3.6, "causal"]))
@example(seed=13157, width="causal")  # begins with a continuous line without an offset
def test_each_log_may_have_its_own_number_of_line_slots(seed: int, width: object) -> None:
    """Frames with up to five lines, gaps of frame ids, frames that were put in."""
    rng = np.random.default_rng(seed)
    log = random_log(seed, 430)
    is_none = np.arange(5) >= rng.integers(0, 6, (430, 1))
    is_none |= log.is_missing[:, None]
    log = replace(
        log,
        offset_m=np.where(is_none, np.nan, log.offset_m),
        is_valid=log.is_valid & ~is_none,
        is_continuous=log.is_continuous & ~is_none,
        lri=np.where(is_none, np.nan, log.lri),
    )
    parameters = resolved(lane_width_m=width)
    whole = line_geometry.online(3, parameters)(log)
    cuts = np.unique([0, *rng.integers(0, 431, 200), 430])
    for edges in (range(431), cuts.tolist()):
        give = line_geometry.online(3, parameters)
        parts = [give(narrow(log.take(slice(a, b)))) for a, b in pairwise(edges)]
        motion = np.concatenate([p.inputs["LineMotion"] for p in parts])
        np.testing.assert_array_equal(motion, whole.inputs["LineMotion"])
        ours = np.concatenate([p.likelihoods[NODES] for p in parts])
        np.testing.assert_array_equal(ours, whole.likelihoods[NODES])


@pytest.mark.parametrize("width", [3.6, "auto", "causal"])
def test_a_log_without_frames_is_no_evidence_and_changes_nothing(width: object) -> None:
    log, parameters = causal_drive("doubled"), resolved(lane_width_m=width)
    none = log.take(slice(0, 0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        given = line_geometry.evidence(none, 3, parameters)
    give, steadily = (line_geometry.online(3, parameters) for _ in range(2))
    parts = [give(none)]
    # The flag semantics are estimated before the frame that follows the first 200.
    for part in (slice(0, 150), slice(150, 200), slice(200, 333), slice(333, None)):
        parts += [give(log.take(part)), give(none)]
    for empty in (given, *parts[::2]):
        assert empty.likelihoods[NODES].shape == (0, 48, 2)
        assert empty.inputs["LineMotion"].shape == (0,)
    ours, whole = Evidence.concat(parts), steadily(log)
    np.testing.assert_array_equal(ours.likelihoods[NODES], whole.likelihoods[NODES])
    np.testing.assert_array_equal(ours.inputs["LineMotion"], whole.inputs["LineMotion"])


def test_the_arrays_of_a_frame_may_be_used_again_for_the_next_one() -> None:
    # Flag semantics are estimated after 200 frames: an LRI of 0 to 1, and no line valid.
    log = causal_drive("plain").take(slice(0, 250))
    log = replace(log, lri=log.lri / 10, is_valid=np.zeros_like(log.is_valid))
    parameters = resolved(lane_width_m="causal")
    give, fresh = (line_geometry.online(3, parameters) for _ in range(2))
    used = log.take(slice(0, 1)).take(np.array([0]))
    for t in range(250):
        frame = log.take(slice(t, t + 1))
        for name in ("frame_id", "time_s", "offset_m", "is_valid", "is_continuous", "lri"):
            getattr(used, name)[:] = getattr(frame, name)
        again, new = give(used), fresh(frame)
        np.testing.assert_array_equal(again.inputs["LineMotion"], new.inputs["LineMotion"])
        np.testing.assert_array_equal(again.likelihoods[NODES], new.likelihoods[NODES])


@pytest.mark.parametrize("width", [3.6, "causal"])
@pytest.mark.parametrize("kind", [np.int64, np.float32])
def test_numbers_need_not_be_of_double_precision(kind: type, width: object) -> None:
    log = random_log(5)
    is_whole = (np.abs(log.offset_m) < 100) & np.isfinite(log.lri)
    log = replace(
        log,
        offset_m=np.where(is_whole, np.rint(log.offset_m), 0.0),
        is_valid=log.is_valid & is_whole,
        lri=np.where(is_whole, log.lri, 0.0),
    )
    other = replace(log, offset_m=log.offset_m.astype(kind), lri=log.lri.astype(kind))
    parameters = resolved(lane_width_m=width)
    ours, theirs = (line_geometry.online(3, parameters)(each) for each in (log, other))
    np.testing.assert_array_equal(theirs.likelihoods[NODES], ours.likelihoods[NODES])


def test_with_a_given_width_the_frames_after_the_first_flag_are_read_as_the_whole() -> None:
    log = causal_drive("plain")
    parameters = resolved(lane_width_m=3.5)
    whole = line_geometry.evidence(log, 3, parameters)
    ours = line_geometry.online(3, parameters)(log).likelihoods[NODES]
    # Until the first continuous line it cannot know that the detector tells them.
    first = int(np.argmax(log.is_continuous.any(axis=1)))
    np.testing.assert_allclose(ours[first:], whole.likelihoods[NODES][first:], atol=1e-12)


def test_the_lane_width_found_is_in_one_warning() -> None:
    log = simulate("quickstart", seed=1, frames=300).log
    with pytest.warns(UserWarning, match=r"lane width 3\.\d\d m from") as caught:
        line_geometry.evidence(log, 3, resolved(lane_width_m="auto"))
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        line_geometry.evidence(log, 3, resolved(lane_width_m=3.7))


@pytest.mark.parametrize("width", ["causal", "auto", 3.7])
def test_a_scale_that_changes_in_the_middle_gives_a_warning(width: object) -> None:
    log = simulate("quickstart", seed=1, frames=3000).log
    for changed, n_warnings in ((log, 0), (scale_changes(log, 0.6), 1), (scaled(log, 0.6), 0)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            line_geometry.evidence(changed, 3, resolved(lane_width_m=width))
        messages = [str(w.message) for w in caught if "first half" in str(w.message)]
        assert len(messages) == n_warnings
        for line in messages:
            assert re.search(
                r"3\.\d+ m in the first half of the recording, 2\.\d+ m in the second: does", line
            )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"lane_width_m": "automatic"}, "'automatic' is not one of auto, causal"),
        ({"lane_width_m": -1}, "must be greater than 0"),
        ({"rates": [1.0, 2.0]}, "needs a list of 3 x 6 numbers, got [1.0, 2.0]"),
        ({"rates": [[1.0], [1.0, 2.0]]}, "every row of the same length"),
        ({"rates": 0.5}, "needs a list of 3 x 6 numbers, got 0.5"),
        ({"sigmas_m": [0.2] * 5 + [0]}, "must be greater than 0"),
        ({"class_shares": [[2.0] * 4] * 6}, "not a probability"),
    ],
)
def test_values_that_do_not_fit_are_named(given: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=r"parameters\." + next(iter(given))) as error:
        resolved(**given)
    assert message in str(error.value)


@pytest.mark.filterwarnings("ignore:line log")
def test_a_table_may_be_nested_or_in_one_row() -> None:
    nested = [[0.1 * k for k in range(6)]] * 3
    flat = [v for row in nested for v in row]
    assert resolved(rates=nested)["rates"] == resolved(rates=flat)["rates"]
    assert isinstance(line_geometry.evidence(line_log([[1.8]]), 3, resolved(rates=flat)), Evidence)


@needs_compiler
def test_placeholders_beside_lines_change_nothing(tmp_path: Path) -> None:
    drive = short_drive(200).log
    offset = np.concatenate([drive.offset_m, np.zeros((200, 1)), np.full((200, 1), np.nan)], axis=1)
    more = LineLog(
        drive.frame_id,
        drive.time_s,
        offset,
        np.concatenate([drive.is_valid, np.ones((200, 1), bool), np.zeros((200, 1), bool)], axis=1),
        np.concatenate([drive.is_continuous, np.zeros((200, 2), bool)], axis=1),
        np.concatenate([drive.lri, np.full((200, 2), 10.0)], axis=1),
    )
    found = []
    for log in (drive, more):
        write_table(tmp_path / "lines.csv", log)
        found.append(run(tmp_path / "lines.csv", n_lanes=3).node("Lane"))
    np.testing.assert_array_equal(*found)


@needs_compiler
def test_a_jump_of_frame_ids_diffuses_the_belief_by_the_frames_that_are_missing(
    tmp_path: Path,
) -> None:
    """As if the missing frames were there and said nothing, which `predict` puts in; up to the
    intervals of the velocity that the lines had before."""
    drive = short_drive(200).log
    kept = np.ones(200, dtype=bool)
    kept[100:105] = False
    write_table(tmp_path / "lines.csv", drive.take(kept))
    belief = {}
    for missing in ("skip", "predict"):
        keys = {"recording.missing_frames": missing}
        found = run(tmp_path / "lines.csv", keys, n_lanes=3)
        belief[missing] = dict(zip(found.frames.index, found.node("Lane"), strict=True))
    ids = drive.frame_id
    assert len(belief["predict"]) == len(belief["skip"]) + 5
    for t in (99, 105, 106, 150):
        np.testing.assert_allclose(belief["skip"][ids[t]], belief["predict"][ids[t]], atol=0.01)
