"""How fast the pieces are that a user waits for, each beside a peer in the same run."""

from __future__ import annotations

import resource
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from heldout import FIXED_POINT_STEPS, fixed_point_inverse
from memory import child
from tables import at_most, interleaved, milliseconds, print_table, ratio

from morphspace.arrays import AnyArray, Displacement, Mask
from morphspace.face.regions import face_mask
from morphspace.grid import warp
from morphspace.io.colour import codes_of
from morphspace.linear.pca import Basis, fit_basis
from morphspace.linear.rows import RowArray
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel, load_model
from morphspace.model.morph import Morph, inner_product

WIDTH, HEIGHT = 200, 240
FACES, COMPONENTS = 300, 100  # of the PCA
NUMBERS = 5 * WIDTH * HEIGHT  # in a face: 240 000
SEED = 0
FIRST = 20  # components drawn while a slider moves
WARP_WEIGHT = 0.05  # colour per px, as builds choose it
WARP_AMOUNTS_PX = (1.0, 3.0, 8.0)  # largest displacement of the drawn fields
DRAWN_ID = "d2a3000000000000"  # the form of an id; nothing else goes by it
DRAWN_ORIGIN = {
    "identity": "drawn",
    "framing": {"source_size": [WIDTH, HEIGHT], "crop": None, "size": [WIDTH, HEIGHT]},
    "reference": {"frame": "f0000", "reason": "drawn", "sha256": "0" * 64},
    "versions": {},
}
OPENING_PX = 12.0  # of the drawn mouth, between two neighbouring rows
MOST_HELP_MS, MOST_VERB_HELP_MS = 200, 400  # processor time


def pca(rounds: int) -> None:
    """Print the time and accuracy of our PCA against scikit-learn's randomised one on the same matrix."""
    from sklearn.decomposition import PCA

    rows = drawn_faces(FACES, NUMBERS)
    weight = np.ones(NUMBERS, np.float32)
    ours: list[tuple[AnyArray, Basis, AnyArray]] = []
    theirs: list[PCA] = []

    def our_fit() -> None:
        ours[:] = [fit_basis(RowArray(rows), weight, COMPONENTS)]

    def their_fit() -> None:
        theirs[:] = [PCA(COMPONENTS, svd_solver="randomized", random_state=SEED).fit(rows)]

    seconds = interleaved({"ours": our_fit, "scikit-learn": their_fit}, rounds)
    share = ratio(seconds["ours"], seconds["scikit-learn"])
    basis, peer = ours[0][1], theirs[0]
    masked = fit_basis(RowArray(rows), inner_product(face_mask(HEIGHT, WIDTH), WARP_WEIGHT), COMPONENTS)[1]
    print(
        f"n = {FACES}, d = {NUMBERS}, k = {COMPONENTS}, float32 in memory, drawn (low rank and noise); median and "
        f"quartiles of {rounds} interleaved fits. Orthonormality: largest entry of |P W P' - 1|, in float64.\n"
    )
    error = orthonormality_error(basis)
    variance = basis.variances.sum()
    print_table(
        ["PCA", "ms", "of scikit-learn's", "target", "orthonormality", "target", "variance kept"],
        [
            [
                "morphspace, exact",
                milliseconds(seconds["ours"]),
                f"{share:.3f}",
                f"<= 0.25 {at_most(share, 0.25)}",
                f"{error:.1e}",
                f"<= 1e-5 {at_most(error, 1e-5)}",
                f"{variance:.6g}",
            ],
            [
                "the same, mask and warp weight",
                "",
                "",
                "",
                f"{orthonormality_error(masked):.1e}",
                f"<= 1e-5 {at_most(orthonormality_error(masked), 1e-5)}",
                "",
            ],
            [
                "scikit-learn, randomized",
                milliseconds(seconds["scikit-learn"]),
                "1",
                "",
                f"{np.abs(peer.components_.astype(np.float64) @ peer.components_.T - np.eye(COMPONENTS)).max():.1e}",
                "",
                f"{peer.explained_variance_.sum():.6g}",
            ],
        ],
    )


def drawn_faces(count: int, numbers: int) -> AnyArray:
    """Draw rows (count, numbers) float32 with variances that fall like those of faces, and noise."""
    rng = np.random.default_rng(SEED)
    rank = min(60, count)
    loadings = rng.standard_normal((count, rank)) * 0.1 * 0.9 ** np.arange(rank)
    rows = loadings.astype(np.float32) @ rng.standard_normal((rank, numbers), np.float32)
    rows += np.float32(0.5) + np.float32(0.01) * rng.standard_normal((count, numbers), np.float32)
    return rows


def orthonormality_error(basis: Basis) -> float:
    """Give the largest entry of |P W P' - 1|, summed in float64."""
    components = basis.components.astype(np.float64)
    product = (components * basis.weight) @ components.T
    return float(np.abs(product - np.eye(basis.rank)).max())


def pca_memory() -> None:
    """Print the memory of the PCA over rows on the disk, in a fresh process each."""
    print("## PCA memory\n")
    print(
        f"n = {FACES}, k = {COMPONENTS}, rows in a `RowFile` on the disk, a fresh process each. Extra: the peak of the "
        "resident set during `fit_basis`, less the resident set just before it (interpreter, imports, the weights) and "
        "less the output (components, mean, loadings). File pages the system caches are not counted.\n"
    )
    table = []
    for numbers in (NUMBERS, 4 * NUMBERS):
        found = child("pca", FACES, numbers, COMPONENTS)
        extra = (found["peak"] - found["before"] - found["output"]) / 1e6
        sizes = [f"{found[key] / 1e6:.0f}" for key in ("input", "before", "peak", "output")]
        table.append([numbers, *sizes, f"{extra:.0f}", f"<= 200 {at_most(extra, 200)}"])
    print_table(["d", "input MB", "before MB", "peak MB", "output MB", "extra MB", "target"], table)


def drawn_model() -> MorphModel:
    """Draw a model of 100 components at 200 x 240: its numbers mean nothing, its sizes are those of a real one."""
    rng = np.random.default_rng(SEED)
    mask: Mask = face_mask(HEIGHT, WIDTH)
    components = rng.standard_normal((COMPONENTS, NUMBERS), np.float32) / np.float32(np.sqrt(NUMBERS))
    variances = 10.0 * 0.95 ** np.arange(COMPONENTS)
    texture = smooth_noise(rng, 3) * np.float32(0.2) + np.float32(0.5)
    mean = Morph.of(texture, drawn_field(1.0), DRAWN_ID)
    still = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    basis = Basis(components, variances, inner_product(mask, WARP_WEIGHT), 0.0)
    loadings = rng.standard_normal((FACES, COMPONENTS)) * np.sqrt(variances)
    training = Loadings(loadings, tuple(f"f{i:04d}" for i in range(FACES)), DRAWN_ID)
    return MorphModel(
        mean, basis, WARP_WEIGHT, mask, texture, still, None, None, training, "similarity", "deepflow",
        DRAWN_ORIGIN,
    )  # fmt: skip


def smooth_noise(rng: np.random.Generator, channels: int) -> AnyArray:
    """Draw a smooth random field (h, w, channels) with its largest value at 1."""
    field = cv2.GaussianBlur(rng.standard_normal((HEIGHT, WIDTH, channels)).astype(np.float32), (0, 0), 12.0)
    out: AnyArray = field / np.float32(np.abs(field).max())
    return out


def drawn_field(amount_px: float) -> Displacement:
    """Draw a smooth displacement (h, w, 2) of at most `amount_px`."""
    return smooth_noise(np.random.default_rng(SEED + 1), 2) * np.float32(amount_px)


def render(rounds: int, work: Path) -> None:
    """Print what drawing a face costs, against one read of its components, and the warp by itself."""
    path = work / "drawn.morph"
    drawn_model().save(path)
    model = load_model(path)
    mapped = model.basis
    in_memory = Basis(np.array(mapped.components), mapped.variances, mapped.weight, 0.0)
    loadings = np.asarray(model.training.values[0])
    flat = in_memory.components.reshape(-1)
    middle = flat.size // 2
    ones = np.ones(NUMBERS, np.float32)
    mean = model.mean.vector
    morph = Morph.of(model.mean.texture, drawn_field(3.0), DRAWN_ID)
    inverse = warp.invert(morph.displacement)
    image = morph.render()
    few = in_memory.truncate(FIRST)
    with ThreadPoolExecutor(2) as pool:
        seconds = interleaved(
            {
                "product": lambda: in_memory.expand(loadings),
                "product, mapped": lambda: mapped.expand(loadings),
                "each row times a vector": lambda: in_memory.components @ ones,
                "dot(x, x)": lambda: np.dot(flat, flat),
                "dot(x, x), two threads": lambda: list(
                    pool.map(lambda half: np.dot(half, half), (flat[:middle], flat[middle:]))
                ),
                "sum, two threads": lambda: list(pool.map(np.sum, (flat[:middle], flat[middle:]))),
                "max, two threads": lambda: list(pool.map(np.max, (flat[:middle], flat[middle:]))),
                "first": lambda: few.expand(loadings[:FIRST]),
                "invert": lambda: warp.invert(morph.displacement),
                "sample": lambda: warp.sample(morph.texture, inverse),
                "codes": lambda: codes_of(image, 8),
                "warp": lambda: codes_of(morph.render(), 8),
                "whole": lambda: _drawn(in_memory, mean, loadings * 0.02),
                "as the model does": lambda: codes_of(model.render(loadings * 0.02), 8),
            },
            rounds,
        )
    reads = (
        "each row times a vector",
        "dot(x, x)",
        "dot(x, x), two threads",
        "sum, two threads",
        "max, two threads",
    )
    best = min(reads, key=lambda name: float(np.median(seconds[name])))
    product, read = seconds["product"], seconds[best]
    first_ms = 1e3 * float(np.median(seconds["first"]))
    warp_ms = 1e3 * float(np.median(seconds["warp"]))
    megabytes = flat.nbytes / 1e6
    print(
        f"Median and quartiles of {rounds} interleaved rounds. One read: the fastest way found to go once over the "
        f"{megabytes:.0f} MB of components, here {best} ({megabytes / 1e3 / np.median(read):.1f} GB/s).\n"
    )

    def row(what: str, key: str, target: str = "") -> list[object]:
        return [what, milliseconds(seconds[key]), f"{ratio(seconds[key], read):.2f}", target]

    share = ratio(product, read)
    print_table(
        ["step", "ms", "of one read", "target"],
        [
            *(row(f"one read: {name}", name) for name in reads),
            row(
                "product of 100 loadings, components in memory", "product", f"<= 1.5 x {at_most(share, 1.5)}"
            ),
            row("the same, components mapped from the file (cached)", "product, mapped"),
            row(
                f"product of the first {FIRST}",
                "first",
                f"<= 1.5 ms {at_most(first_ms, 1.5)}; goal 1 {at_most(first_ms, 1)}",
            ),
            row(
                "invert + sample + to uint8",
                "warp",
                f"<= 10 ms {at_most(warp_ms, 10)}; goal 5 {at_most(warp_ms, 5)}",
            ),
            row("- invert", "invert"),
            row("- sample", "sample"),
            row("- to uint8", "codes"),
            row("all of it, loadings to uint8", "whole"),
            row("`MorphModel.render` and to uint8, mapped", "as the model does"),
        ],
    )


def _drawn(basis: Basis, mean: AnyArray, loadings: AnyArray) -> AnyArray:
    return codes_of(Morph(mean + basis.expand(loadings), (HEIGHT, WIDTH), DRAWN_ID).render(), 8)[0]


def open_model(rounds: int, work: Path) -> None:
    """Print how long opening a 96 MB model takes, in fresh processes and again in the same one."""
    path = work / "drawn.morph"
    drawn_model().save(path)
    found = [child("open", str(path), rounds) for _ in range(max(3, rounds // 4))]
    cold, first, warm = (
        np.array([one[key] for one in found]) for key in ("uncached_s", "first_s", "again_s")
    )
    print(
        f"`load_model` of {path.stat().st_size / 1e6:.0f} MB in {len(found)} fresh processes, imports not counted; "
        "median and quartiles. Not cached: the system was asked to drop the file's pages first "
        "(posix_fadvise). First: the digest of the content is compared. Again: the file is unchanged, and is not read. "
        "Peer: reading the whole file once, cached, in the same process.\n"
    )
    whole = np.array([one["read_s"] for one in found])
    print_table(
        ["open", "ms", "of reading the file", "target"],
        [
            [
                what,
                milliseconds(s),
                f"{ratio(s, whole):.3f}",
                f"<= 5 ms {at_most(1e3 * float(np.median(s)), 5)}",
            ]
            for what, s in (("first, file not cached", cold), ("first, file cached", first), ("again", warm))
        ],
    )


def inversion(rounds: int) -> None:
    """Print our exact inversion against SciPy's scattered interpolation: time, and how far the two differ."""
    from scipy.interpolate import LinearNDInterpolator

    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    grid = np.stack([x, y], axis=-1)

    def scattered(displacement: Displacement) -> AnyArray:
        moved = (grid + displacement).reshape(-1, 2)
        out: AnyArray = LinearNDInterpolator(moved, grid.reshape(-1, 2))(grid) - grid
        return out

    print(
        "Drawn fields without folds. SciPy triangulates the moved points anew (Delaunay), ours keeps the grid's own "
        "triangles; compared inside the face mask, because at the border SciPy fills the hull with slivers. Median and "
        f"quartiles of {rounds} interleaved rounds; distances are median / 99th percentile / largest. A miss is how "
        "far u after its inverse is from standing still, u read bilinearly: on smooth fields that favours the fixed "
        f"point ({FIXED_POINT_STEPS} steps), which inverts just that reading; ours inverts the triangles that "
        "`render` draws.\n"
    )
    inside = face_mask(HEIGHT, WIDTH) > 0
    fields = {f"smooth, {amount:.0f} px": drawn_field(amount) for amount in WARP_AMOUNTS_PX}
    fields[f"opening mouth, {OPENING_PX:.0f} px"] = opening_field()
    rows = []
    for name, field in fields.items():
        works = {"ours": partial(warp.invert, field), "scipy": partial(scattered, field)}
        seconds = interleaved(works, rounds)
        rows.append(
            [
                name,
                int((warp.determinants(field) <= 0).sum()),
                milliseconds(seconds["ours"]),
                milliseconds(seconds["scipy"]),
                f"{ratio(seconds['ours'], seconds['scipy']):.4f}",
                _quantiles((warp.invert(field) - scattered(field))[inside]),
                _quantiles(warp.compose(field, warp.invert(field))[inside]),
                _quantiles(warp.compose(field, fixed_point_inverse(field))[inside]),
            ]
        )
    heads = ["field", "folds", "ours ms", "SciPy ms", "ratio", "ours - SciPy px", "ours misses by px"]
    print_table([*heads, "fixed point misses by px"], rows)


def opening_field() -> Displacement:
    """Draw a mouth that opens: lips part along one row and the rest of the face follows less and less, (h, w, 2)."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    below = y - np.float32(0.72 * HEIGHT) + np.float32(0.5)
    reach = np.exp(-(((x - WIDTH / 2) / 30) ** 2) - np.abs(below) / 30)
    down = OPENING_PX / 2 * np.sign(below) * reach
    return np.stack([np.zeros_like(down), down], axis=-1).astype(np.float32)


def _quantiles(difference: AnyArray) -> str:
    length = np.hypot(difference[..., 0], difference[..., 1])
    return " / ".join(f"{value:.1e}" for value in np.percentile(length, [50, 99, 100]))


def help_time(rounds: int) -> None:
    """Print the processor time of the command line's help in a fresh process, beside NumPy's import and Python."""
    print(
        "Processor time of a fresh process with all its threads, so that other work on the machine does not count; "
        f"median and quartiles of {rounds} interleaved rounds.\n"
    )
    starts = {
        "morphspace --help": (["-m", "morphspace", "--help"], MOST_HELP_MS),
        "morphspace mimic --help": (["-m", "morphspace", "mimic", "--help"], MOST_VERB_HELP_MS),
        "import numpy": (["-c", "import numpy"], None),
        "python": (["-c", "pass"], None),
    }

    def work(words: list[str]) -> None:
        subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)

    def clock() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    seconds = interleaved({name: partial(work, words) for name, (words, _) in starts.items()}, rounds, clock)
    rows = []
    for name, (_, most) in starts.items():
        share = f"{ratio(seconds[name], seconds['import numpy']):.2f}"
        found = float(np.median(seconds[name])) * 1e3
        target = "" if most is None else f"< {most} ms {at_most(found, most)}"
        rows.append([name, milliseconds(seconds[name]), share, target])
    print_table(["start", "ms", "of import numpy", "target"], rows)
