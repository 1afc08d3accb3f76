"""Laws of measuring mimicry: what a copy, a delay, a warp, a gain and chance give, and estimators against truth."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage, stats
from sklearn.feature_selection import mutual_info_regression

from morphspace.errors import BadInput
from morphspace.imitation import align, compare, masked_basis
from morphspace.imitation.chance import baseline_of, familywise, in_pieces, of_random_phases, p_values
from morphspace.imitation.information import entropy, mutual_information
from morphspace.imitation.shape import lag_curves, peak, similarity, standardised
from morphspace.linear.pca import Basis
from morphspace.steps import result_of

SD = np.array([3.0, 1.0, 0.5])


def motion(frames, components=3, seed=0, smooth_frames=2.0):
    """A smooth random motion (frames, components) in SD."""
    noise = np.random.default_rng(seed).standard_normal((frames, components))
    smooth = ndimage.gaussian_filter1d(noise, smooth_frames, axis=0) if smooth_frames else noise
    return smooth / smooth.std(axis=0)


def compared(stimulus, imitation, sd=None, permutations=1000, seed=0):
    sd = np.ones(stimulus.shape[1]) if sd is None else sd
    return result_of(compare(stimulus, imitation, sd, permutations=permutations, seed=seed))


def test_a_sequence_is_its_own_perfect_imitation():
    itself = motion(60)
    found = compared(itself, itself, SD)
    measures = found.measures
    for name in ("correlation", "cosine", "gain", "correlation_at_lag", "correlation_aligned"):
        assert_allclose(measures[name], 1, atol=1e-9, err_msg=name)
    for name in ("distance_sd", "distance", "distance_centred_sd", "lag_frames"):
        assert_array_equal(measures[name], 0, err_msg=name)
    assert measures["alignment_cost"][-1] == 0
    assert found.alignment.timing_rms_frames == 0
    assert len(found.alignment.path) == 60
    for name in ("correlation_p", "distance_sd_p"):
        assert measures[name][-1] == 1 / 60, name  # no shift of 59 comes as close
    for name in ("correlation_aligned_p", "alignment_cost_p"):
        assert measures[name][-1] == 1 / 200, name  # no copy of 199 of either kind does
    assert_array_equal(measures["correlation_p_familywise"][:-1], 1 / 60)
    assert_array_equal(measures["entropy_stimulus_nats"], measures["entropy_imitation_nats"])


@pytest.mark.parametrize("delay", [-9, -1, 0, 4, 12])
def test_a_delay_is_found_as_a_lag_of_so_many_frames(delay):
    whole = motion(120, seed=3)
    stimulus, imitation = whole[20:90], whole[20 - delay : 90 - delay]
    found = compared(stimulus, imitation, SD, permutations=20)
    assert_array_equal(found.measures["lag_frames"], delay)
    assert_allclose(found.measures["correlation_at_lag"], 1, atol=1e-9)


def test_a_lag_is_found_between_sequences_of_different_length():
    whole = motion(120, seed=4)
    found = compared(whole[10:60], whole[3:100], SD, permutations=5)
    assert_array_equal(found.measures["lag_frames"], 7)


def test_a_curve_of_lags_is_a_correlation_over_each_overlap():
    a, b = motion(30, seed=1), motion(37, seed=2)
    lags, curves = lag_curves(a, b[None])
    for place in (0, 5, len(lags) - 1):
        t = np.arange(30)
        t = t[(t + lags[place] >= 0) & (t + lags[place] < 37)]
        expected = [np.corrcoef(a[t, c], b[t + lags[place], c])[0, 1] for c in range(3)]
        assert_allclose(curves[0, place, :3], expected, atol=1e-9)


def test_alignment_undoes_a_change_of_timing_and_tells_of_it():
    time = np.arange(100.0)
    bend = 10 * np.sin(np.pi * time / 99) ** 2  # frames; monotonic, both ends kept
    stimulus = motion(100, seed=5, smooth_frames=4.0)
    imitation = ndimage.map_coordinates(
        stimulus, np.meshgrid(time - bend, np.arange(3.0), indexing="ij"), order=3, mode="nearest"
    )
    found = compared(stimulus, imitation, SD, permutations=50)
    assert found.measures["correlation"][-1] < 0.7
    assert found.measures["correlation_aligned"][-1] > 0.99
    truth = np.sqrt(np.mean(bend**2))
    assert abs(found.alignment.timing_rms_frames - truth) < 1  # frame: a path goes in whole frames
    assert found.alignment.delay_frames == pytest.approx(bend.mean(), abs=1)
    even = compared(stimulus, stimulus, SD, permutations=5)
    assert even.alignment.timing_rms_frames == 0


def test_alignment_is_the_cheapest_of_all_paths():
    rng = np.random.default_rng(8)
    one, other = rng.standard_normal((6, 2)), rng.standard_normal((5, 2))
    costs = np.hypot(*np.moveaxis(one[:, None] - other, -1, 0))

    def cheapest(i, j):
        before = [(i - 1, j - 1), (i - 1, j), (i, j - 1)]
        reachable = [cheapest(*cell) for cell in before if min(cell) >= 0]
        return costs[i, j] + min(reachable, default=0.0)

    found = align(one, other, band=1.0)
    assert found.cost == pytest.approx(cheapest(5, 4), abs=1e-12)
    assert found.cost == pytest.approx(costs[tuple(found.path.T)].sum(), abs=1e-12)
    steps = np.diff(found.path, axis=0)
    assert ((steps >= 0) & (steps <= 1)).all() and steps.any(axis=1).all()


def test_a_gain_changes_distances_and_not_correlations():
    stimulus = motion(50)
    imitation = stimulus + 0.4 * motion(50, seed=9)
    plain = compared(stimulus, imitation, SD).measures
    larger = compared(stimulus, 2.5 * imitation, SD).measures
    unchanged = (
        "correlation",
        "cosine",
        "correlation_at_lag",
        "lag_frames",
        "correlation_p",
        "alignment_cost",
    )
    for name in (*unchanged, "correlation_aligned", "mutual_information_nats"):
        assert_allclose(larger[name], plain[name], atol=1e-9, err_msg=name)
    assert_allclose(larger["gain"], 2.5 * plain["gain"], rtol=1e-9)
    assert (larger["distance_sd"] > plain["distance_sd"]).all()
    assert_allclose(
        larger["entropy_imitation_nats"][:-1] - plain["entropy_imitation_nats"][:-1], np.log(2.5), atol=1e-9
    )


def test_an_offset_changes_distances_and_not_what_is_centred():
    stimulus = motion(50)
    imitation = stimulus + 0.4 * motion(50, seed=9)
    plain = compared(stimulus, imitation, SD, permutations=20).measures
    moved = compared(stimulus, imitation + 5, SD, permutations=20).measures
    for name in ("correlation", "distance_centred_sd", "correlation_aligned", "gain"):
        assert_allclose(moved[name], plain[name], atol=1e-9, err_msg=name)
    assert (moved["distance_sd"] > plain["distance_sd"]).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["correlation_p", "distance_sd_p"])
def test_independent_motions_have_uniform_p_values(name):
    p = all_p_of_chance()[name]
    p = p - np.random.default_rng(0).uniform(0, 1 / 20, len(p))  # 20 frames give p in steps of 1/20
    assert stats.kstest(p, "uniform").pvalue > 0.01
    assert (p <= 0.1).mean() < 0.16  # 0.1 and two standard errors of 200 draws


@pytest.mark.slow
@pytest.mark.parametrize("name", ["correlation_at_lag_p", "correlation_aligned_p"])
def test_independent_motions_are_seldom_called_imitations_after_a_search(name):
    """The larger of two p is a little larger than uniform."""
    p = all_p_of_chance()[name]
    assert (p <= 0.1).mean() < 0.16
    assert 0.45 < p.mean() < 0.65


def all_p_of_chance(cache={}):  # noqa: B006 - a cache, filled once
    if not cache:
        rows = []
        for seed in range(200):
            one, other = motion(20, 2, 1000 + seed, 0), motion(20, 2, 5000 + seed, 0)
            rows.append({k: v[-1] for k, v in compared(one, other, permutations=19).measures.items()})
        cache.update({name: np.array([row[name] for row in rows]) for name in rows[0]})
    return cache


def walk(rng, frames, components):
    return rng.standard_normal((frames, components)).cumsum(axis=0)


def smooth(rng, frames, components):
    return ndimage.gaussian_filter1d(rng.standard_normal((frames + 40, components)), 4, axis=0)[20:-20]


def faint(rng, frames, components):
    return ndimage.gaussian_filter1d(rng.standard_normal((frames + 40, components)), 1.5, axis=0)[20:-20]


def events(rng, frames, components):
    """Three expressions at random times, each moving all components together."""
    when = ndimage.gaussian_filter1d((rng.random(frames + 40) < 3 / frames) * 1.0, 3)[20:-20]
    return when[:, None] * rng.standard_normal(components) + 0.02 * faint(rng, frames, components)


def p_at_lag(stimulus, imitation, seed, copies=39):
    lags, curves = lag_curves(stimulus, imitation[None])
    found = peak(curves[0], lags)[1]
    p = []
    for kind in (of_random_phases, in_pieces):
        chance = np.concatenate(list(kind(imitation, copies, seed)))
        null = np.array([peak(curve, lags)[1] for curve in lag_curves(stimulus, chance)[1]])
        p.append(p_values(found, null)[-1])
    return max(p)


@pytest.mark.parametrize(
    ("kind", "components"),
    [
        (smooth, 1),
        (events, 6),
        *(
            pytest.param(kind, components, marks=pytest.mark.slow)
            for kind, components in ((smooth, 6), (walk, 1), (walk, 6), (faint, 1), (faint, 6), (events, 1))
        ),
    ],
)
def test_independent_smooth_motions_do_not_imitate_at_their_best_lag(kind, components):
    """Not more than one in twenty of 200 pairs, and two standard errors (.03); nor does nothing ever pass."""
    p = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        one, other = kind(rng, 60, components), kind(rng, 60, components)
        p.append(p_at_lag(one, other, seed))
    assert np.mean(np.array(p) <= 0.05) <= 0.08
    assert 0.1 < np.mean(np.array(p) <= 0.2) < 0.3


@pytest.mark.parametrize(("frames", "components"), [(24, 3), (60, 50)])
@pytest.mark.parametrize("delay", [-5, 5])
def test_a_copy_that_is_late_has_a_small_p_at_its_best_lag(frames, components, delay):
    """However many shifts would be undone by the search: chance is no shift."""
    whole = motion(frames + 5, components, seed=3)
    stimulus, imitation = whole[5:], whole[:-5]
    if delay < 0:
        stimulus, imitation = imitation, stimulus
    found = compared(stimulus, imitation, permutations=199).measures
    assert_array_equal(found["lag_frames"], delay)
    assert found["correlation_at_lag_p"][-1] <= 0.02
    assert found["correlation_aligned_p"][-1] < 0.05


def test_copies_of_random_phases_keep_spectra_and_what_components_have_in_common():
    given = motion(30, 2, seed=6)
    given[:, 1] += given[:, 0]
    copies = np.concatenate(list(of_random_phases(np.column_stack([given, np.full(30, 0.3)]), 4000, 0)))
    assert copies.shape == (4000, 30, 3)
    assert_array_equal(copies[..., 2], 0.3)  # what does not move stays
    assert_allclose(copies.mean(axis=(0, 1)), [*given.mean(axis=0), 0.3], atol=0.02)
    a, b = (given - given.mean(axis=0)).T
    moved = copies[..., :2] - given.mean(axis=0)
    for lag in (0, 1, 4):  # the mean over copies of a product is that over the sequence and its reflection
        for one, x in enumerate((a, b)):
            for other, y in enumerate((a, b)):
                both = np.concatenate([x, x[::-1]]), np.concatenate([y, y[::-1]])
                truth = (both[0] * np.roll(both[1], -lag)).mean()
                found = (moved[:, : 30 - lag, one] * moved[:, lag:, other]).mean()
                assert found == pytest.approx(truth, abs=0.05)
    assert np.abs(np.corrcoef(copies[..., 0].T)[0, 15]) < 0.9


def test_copies_in_pieces_hold_every_frame_once_and_mostly_its_neighbours():
    given = np.arange(40.0)[:, None]
    copies = np.concatenate(list(in_pieces(given, 50, 0)))[..., 0]
    assert_array_equal(np.sort(copies, axis=1), np.tile(np.arange(40.0), (50, 1)))
    jumps = (np.abs(np.diff(copies, axis=1)) % 38 != 1).sum(axis=1)  # 39 is the turn's own seam
    assert jumps.max() <= 4 and jumps.mean() > 3
    for frames in (3, 4, 5, 8):
        few = np.concatenate(list(in_pieces(given[:frames], 5, 0)))[..., 0]
        assert_array_equal(np.sort(few, axis=1), np.tile(np.arange(float(frames)), (5, 1)))


@pytest.mark.parametrize("kind", [of_random_phases, in_pieces])
def test_copies_are_those_of_the_seed_however_many_are_made_at_a_time(kind, monkeypatch):
    given = motion(20)
    whole = np.concatenate(list(kind(given, 7, 3)))
    monkeypatch.setattr("morphspace.imitation.chance.CHUNK_NUMBERS", 130)
    assert_array_equal(np.concatenate(list(kind(given, 7, 3))), whole)
    assert (np.concatenate(list(kind(given, 7, 4))) != whole).any()


def test_smoothness_alone_is_not_taken_for_mimicry():
    """Shuffled frames would call most of these significant; turned ones may not."""
    hits = []
    for seed in range(60):
        one, other = motion(80, 1, 100 + seed, 5.0), motion(80, 1, 900 + seed, 5.0)
        correlation = similarity(one, other)[0]
        turned = np.stack([similarity(one, np.roll(other, s, axis=0))[:1] for s in range(1, 80)])
        shuffles = np.random.default_rng(seed)
        shuffled = np.stack([similarity(one, shuffles.permutation(other))[:1] for _ in range(99)])
        hits.append([p_values(np.array([correlation]), null)[0] <= 0.05 for null in (turned, shuffled)])
    honest, naive = np.mean(hits, axis=0)
    assert honest <= 0.12  # 0.05 and 2.5 standard errors of 60 draws
    assert naive > 2 * honest


def test_a_familywise_p_is_never_below_that_of_one_component():
    one, other = motion(40, 5, 1), motion(40, 5, 2)
    measures = compared(one, other).measures
    assert (measures["correlation_p_familywise"][:-1] >= measures["correlation_p"][:-1]).all()
    null = np.array([[0.1, 0.9, 0.0], [0.8, 0.2, 0.0], [0.3, 0.1, 0.0]])
    assert_allclose(familywise(np.array([0.85, 0.05, 0.0]), null)[:2], [2 / 4, 4 / 4])


@pytest.mark.parametrize("r", [0.0, 0.3, 0.6, 0.9])
def test_mutual_information_of_a_gaussian_pair_is_that_of_its_formula(r):
    rng = np.random.default_rng(17)
    found = []
    for _ in range(10):
        x, noise = rng.standard_normal((2, 2000))
        found.append(mutual_information(x, r * x + np.sqrt(1 - r * r) * noise))
    assert np.mean(found) == pytest.approx(-0.5 * np.log(1 - r * r), abs=0.02)  # nats; 3 SE of these draws


def test_mutual_information_agrees_with_scikit_learn():
    rng = np.random.default_rng(3)
    x = rng.standard_normal(400)
    y = np.sin(2 * x) + 0.3 * rng.standard_normal(400)
    theirs = mutual_info_regression(x[:, None], y, n_neighbors=3, random_state=0)[0]
    assert mutual_information(x, y) == pytest.approx(theirs, abs=1e-6)  # they add noise of 1e-10


def test_entropy_of_a_gaussian_is_that_of_its_formula():
    rng = np.random.default_rng(4)
    found = [entropy(1.7 * rng.standard_normal(1000)) for _ in range(10)]
    assert np.mean(found) == pytest.approx(0.5 * np.log(2 * np.pi * np.e * 1.7**2), abs=0.03)


def test_the_order_of_components_changes_no_total():
    one, other = motion(40, 3, 1), motion(40, 3, 2) + motion(40, 3, 1)
    order = [2, 0, 1]
    plain = compared(one, other, SD).measures
    mixed = compared(one[:, order], other[:, order], SD[order]).measures
    for name in plain:
        assert_allclose(mixed[name][-1], plain[name][-1], atol=1e-9, err_msg=name)
        assert_allclose(mixed[name][:-1], plain[name][order], atol=1e-9, err_msg=name)


def test_all_together_are_weighed_by_plain_loadings_at_every_lag():
    one, other = motion(40, 3, 1), motion(40, 3, 2)
    found = compared(one, other, SD, permutations=5)
    a, b = ((sequence - sequence.mean(axis=0)) * SD for sequence in (one, other))
    truth = (a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum())
    assert found.measures["correlation"][-1] == pytest.approx(truth)
    assert found.curve[found.lags == 0] == pytest.approx(truth)


def test_constant_traces_have_a_defined_answer():
    one, other = motion(30), motion(30, seed=1)
    other[:, 1] = 0.1 + 0.2  # not exactly represented, and its mean over frames is not either
    measures = compared(one, other, SD).measures
    for name in (
        "correlation",
        "correlation_p",
        "mutual_information_nats",
        "lag_frames",
        "correlation_aligned",
    ):
        assert np.isnan(measures[name][1]), name
        assert np.isfinite(measures[name][[0, 2, 3]]).all(), name
    assert measures["gain"][1] == 0
    assert np.isfinite(measures["distance_sd"]).all()


def test_two_sequences_that_do_not_move_are_compared_by_distance_alone():
    still = np.ones((12, 3))
    measures = compared(still, 3 * still, SD).measures
    assert_allclose(measures["distance_sd"], [2, 2, 2, 2 * np.sqrt(3)])
    assert_allclose(measures["cosine"], 1)
    for name in ("correlation", "gain", "lag_frames", "alignment_cost", "alignment_cost_p"):
        assert np.isnan(measures[name]).all(), name


def test_a_constant_shift_list_is_all_there_are_or_a_seeded_sample():
    assert_array_equal(baseline_of(10, 1000, 0).shifts, np.arange(1, 10))
    assert baseline_of(10, 9, 0).is_exhaustive and not baseline_of(10, 8, 0).is_exhaustive
    some = baseline_of(500, 50, 1).shifts
    assert len(set(some.tolist())) == 50 and some.min() >= 1 and some.max() < 500
    assert_array_equal(some, baseline_of(500, 50, 1).shifts)
    assert (some != baseline_of(500, 50, 2).shifts).any()
    assert len(baseline_of(500, 499, 1).costly) == 199
    short = baseline_of(24, 1000, 0)
    assert short.least == {
        "frame_by_frame": 1 / 24,
        "information": 1 / 24,
        "lag": 1 / 1001,
        "alignment": 1 / 200,
    }


def test_without_permutations_there_are_no_p_values():
    measures = compared(motion(30), motion(30, seed=1), permutations=0).measures
    assert np.isnan(measures["correlation_p"]).all() and np.isfinite(measures["correlation"]).all()


def test_the_same_seed_gives_the_same_numbers():
    one, other = motion(80), motion(80, seed=1)
    first, again, another = (compared(one, other, SD, 30, seed).measures for seed in (1, 1, 2))
    assert all(np.array_equal(first[name], again[name], equal_nan=True) for name in first)
    assert any(not np.array_equal(first[name], another[name], equal_nan=True) for name in first)


def test_of_equal_peaks_the_least_lag_is_taken():
    wave = np.sin(2 * np.pi * np.arange(60) / 10)[:, None]
    lags, curves = lag_curves(wave, wave[None])
    assert_array_equal(peak(curves[0], lags)[0], 0)


def test_standardising_takes_place_and_size_away():
    shape = standardised(7 + 3 * motion(20))
    assert_allclose(shape.mean(axis=0), 0, atol=1e-12)
    assert (shape**2).sum() == pytest.approx(20)


def orthonormal_basis(rank, d, discarded, seed=0):
    rows = np.linalg.qr(np.random.default_rng(seed).standard_normal((d, rank)))[0].T.astype(np.float32)
    return Basis(rows, np.linspace(4, 1, rank), np.ones(d, np.float32), discarded)


def test_a_part_that_is_the_whole_face_gives_the_projection():
    basis = orthonormal_basis(4, 200, 1e-9)
    offset = np.random.default_rng(1).standard_normal(200).astype(np.float32)
    part = masked_basis(basis, np.ones(200))
    assert_allclose(part.visible_share, 1, atol=1e-5)
    assert_allclose(part.mean(offset), basis.project(offset), atol=0.005)  # the least prior shrinks by 1e-3


def test_what_a_model_can_say_is_found_again_from_a_part_of_the_face():
    basis = orthonormal_basis(3, 300, 1e-9)
    share = (np.arange(300) < 150).astype(np.float32)
    truth = np.array([[1.5, -0.7, 0.3], [0.2, 0.1, -2.0]])
    part = masked_basis(basis, share)
    faces = basis.expand(truth)
    outside = faces.copy()
    outside[:, 150:] = 99.0  # what the mask leaves out may be anything
    assert_allclose([part.mean(face) for face in outside], truth, atol=0.02)
    assert_allclose(part.mean_of_faces(truth), [part.mean(face) for face in faces], atol=1e-4)
    naive = (share * faces) @ basis.components.T
    assert np.abs(naive - truth).max() > 0.2


def test_one_number_in_a_hundred_is_independent():
    assert masked_basis(orthonormal_basis(3, 300, 0.01), np.ones(300)).noise == pytest.approx(1.0)  # anchored


def test_a_component_that_the_part_does_not_show_stays_at_the_mean():
    rows = np.zeros((2, 10), np.float32)
    rows[0, :5], rows[1, 5:] = 5**-0.5, 5**-0.5
    basis = Basis(rows, np.array([2.0, 1.0]), np.ones(10, np.float32), 0.0)
    part = masked_basis(basis, (np.arange(10) < 5).astype(np.float32))
    assert_allclose(part.visible_share, [1, 0], atol=1e-6)
    assert_allclose(part.mean_of_faces(np.array([[3.0, 4.0]])), [[3.0, 0.0]], atol=0.01)


@pytest.mark.parametrize(
    ("stimulus", "imitation", "words"),
    [
        (np.zeros((1, 3)), np.zeros((5, 3)), "stimulus has 1 frame"),
        (np.zeros((5, 3)), np.zeros((2, 3)), "imitation has 2 frame"),
        (np.zeros((5, 3)), np.zeros((5, 2)), "3 components, the imitation 2"),
        (np.zeros((5, 3)), np.full((5, 3), np.nan), "nan in frame 0, component 1"),
        (np.zeros((5, 0)), np.zeros((5, 0)), "k at least 1"),
    ],
)
def test_what_cannot_be_compared_is_named(stimulus, imitation, words):
    with pytest.raises(BadInput, match=words):
        compared(stimulus, imitation)


def test_a_mask_that_leaves_nothing_is_refused():
    with pytest.raises(BadInput, match="leaves nothing"):
        masked_basis(orthonormal_basis(2, 20, 0.1), np.zeros(20))
