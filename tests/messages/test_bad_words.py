"""What is wrong with a command is said in one line that names it; the exit code is 2, and no file changes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from click.testing import CliRunner

from morphspace.cli.main import main
from morphspace.face.faceframe import FaceFrame
from morphspace.flow.pairs import MIN_SIDE_PX
from morphspace.io.flow_fields import write_flows
from morphspace.io.images import write_image
from morphspace.model.loadings import Loadings
from morphspace.verbs.encode import write_loadings

HEIGHT, WIDTH = 48, 64  # of a.png and b.png


@pytest.fixture(scope="module")
def lab(model, picture, tmp_path_factory):
    """A folder with whatever a verb may be given, and much that is broken."""
    folder = tmp_path_factory.mktemp("lab")
    model.save(folder / "plain.morph")
    framing = {"source_size": [60, 72], "crop": None, "size": [60, 72]}
    replace(model, provenance={**model.provenance, "framing": framing}).save(folder / "m.morph")
    for name, x in (("anna", 20.0), ("ben", 18.0)):
        person = replace(model, provenance={**model.provenance, "identity": name})
        person.with_faceframe(FaceFrame((x, 30.0), (44.0, 30.0), (32.0, 50.0))).save(folder / f"{name}.morph")
    rows = Loadings(model.training.values[:3], model.training.frame_names[:3], model.model_id)
    write_loadings(folder / "t.csv", rows, model, folder / "m.morph", {})
    (folder / "nan.csv").write_text(
        f"frame,point,x_px,y_px\n{rows.frame_names[0]},0,1,2\n{rows.frame_names[0]},1,nan,2\n"
    )
    (folder / "recipe.yaml").write_text("model: m.morph\nstimuli:\n  - verb: sample\n    n: 2\n")
    (folder / "dangling").symlink_to("gone")
    (folder / "clip").mkdir()
    for name, row in zip(rows.frame_names, rows.values, strict=True):
        write_image(folder / "clip" / f"{name}.png", model.render(row))
    for name, height, width in (
        ("a", HEIGHT, WIDTH),
        ("b", HEIGHT, WIDTH),
        ("other", HEIGHT, WIDTH + 1),
        ("small", MIN_SIDE_PX - 1, WIDTH),
    ):
        write_image(folder / f"{name}.png", picture(height, width, len(name)))
    image = picture(HEIGHT, WIDTH)
    for name, value in (("nan", np.nan), ("infinite", np.inf), ("glaring", 1e30)):
        image[3, 4] = value
        raw_image(folder / f"{name}.exr", image)
        raw_image(folder / f"{name}.tif", image)
    (folder / "empty.png").write_bytes(b"")
    for name in ("folder.flo", "taken.back.flo"):
        (folder / name).mkdir()
    ones = np.ones((HEIGHT, WIDTH), np.float32)
    far = np.broadcast_to(np.float32([1e6, 0]), (HEIGHT, WIDTH, 2))
    write_flows({folder / "far.flo": (far, ones), folder / "other.flo": (0 * far[1:], ones[1:])})
    (folder / "cut.flo").write_bytes((folder / "far.flo").read_bytes()[:-1])
    return folder


def raw_image(path, image):
    target = oiio.ImageOutput.create(str(path))
    spec = oiio.ImageSpec(image.shape[1], image.shape[0], image.shape[2], "float")
    assert target.open(str(path), spec) and target.write_image(image) and target.close()


# Words of a command, and those its line must name; `|` is a blank inside a word, or by itself an empty word.
BAD = (
    ("flow a.png other.png -o o.flo", "64x48 65x48 a.png other.png"),
    ("flow a.png small.png -o o.flo", "small.png 64x15 16"),
    ("flow small.png a.png -o o.flo", "small.png 64x15 16"),
    ("flow a.png nan.exr -o o.flo", "nan.exr finite"),
    ("flow nan.tif a.png -o o.flo", "nan.tif finite"),
    ("flow a.png infinite.exr -o o.flo", "infinite.exr finite"),
    ("flow a.png glaring.tif -o o.flo", "glaring.tif 1e+30"),
    ("flow glaring.exr glaring.exr -o o.flo", "glaring.exr"),
    ("flow nowhere.png b.png -o o.flo", "nowhere.png"),
    ("flow a.png nowhere.png -o new/o.flo", "nowhere.png"),
    ("flow a.png empty.png -o o.flo", "empty.png empty"),
    ("flow a.png folder.flo -o o.flo", "folder.flo"),
    ("flow a.png b.png -o o.png", "o.png .flo .exr"),
    ("flow a.png b.png -o o", ".flo .exr"),
    ("flow a.png b.png -o folder.flo", "folder.flo folder"),
    ("flow a.png b.png -o a.png/o.flo", "a.png"),
    ("flow a.png b.png -o taken.flo --both", "taken.back.flo"),
    ("flow a.png b.png -o o.flo --picture a.png", "a.png replaced"),
    ("flow a.png b.png -o o.flo --picture p.jpg", "p.jpg .png"),
    ("flow a.png b.png -o o.flo --picture a.png/p.png", "a.png"),
    ("flow nan.exr b.png -o nan.exr", "nan.exr replaced"),
    ("flow a.png b.png -o other.flo --start other.flo", "other.flo replaced"),
    ("flow a.png b.png -o o.flo --start nowhere.flo", "nowhere.flo"),
    ("flow a.png b.png -o o.flo --start a.png", "a.png .flo"),
    ("flow a.png b.png -o o.flo --start other.flo", "other.flo 64x47 64x48"),
    ("flow a.png b.png -o o.flo --start cut.flo", "cut.flo cut short"),
    ("flow a.png b.png -o o.flo --start far.flo", "far.flo 1e+06"),
    ("flow a.png b.png -o o.flo --preset magic", "magic"),
    ("flow a.png b.png -o o.flo --preset dis --preset tvl1", "2 presets"),
    ("flow a.png b.png", "-o"),
    ("flow a.png -o o.flo", "1 given"),
    ("flow ", "0 given"),
    ("flow a.png b.png b.png -o o.flo", "3 given"),
    ("flow --bench nowhere", "nowhere"),
    ("flow --bench a.png", "a.png"),
    ("flow --bench .", "flow10.flo"),
    ("flow --bench . a.png b.png", "--bench"),
    ("flow --bench . --both", "--bench"),
    ("flow --bench . --landmarks a.png b.png", "--bench --landmarks"),
    ("flow --bench . --backend torch --preset paper", "paper torch"),
    ("flow a.png b.png -o o.flo --landmarks a.png b.png", "a.png .tem"),
    ("flow a.png b.png -o o.flo --landmarks a.tem nowhere.tem", "a.tem"),
    ("flow a.png b.png -o o.flo --backend abacus", "abacus"),
    ("info t.csv", "t.csv no .morph Check"),
    ("mimick anna.morph", "'mimick'. mean mimic? See"),
    ("models fetsh", "'fetsh'. mean fetch? See"),
    ("zzz", "'zzz'. See"),
    ("trajectory m.morph t.csv --op -o t", "--op 0 values before -o; expected 1."),
    ("grid m.morph --components 1 -o out", "--components 1 value before -o; expected 2. N"),
    ("grid m.morph -o out -n 2", "-n 1 value; expected 2. NUMBER See grid --help"),
    ("grid m.morph -n -o out", "-n 0 values before -o; expected 2."),
    ("grid m.morph --components a b -o out", "--components 'a', 'b'; expected 2 whole numbers"),
    ("grid m.morph --components 2 2 -o out", "2 different 1 3. Choose others"),
    ("make-actors -o out --size 2x2", "2x2 px; px. Choose another"),
    ("continuum anna.morph anna.morph -o out", "anna; expected two. Give another"),
    ("continuum t.csv:zz t.csv:frame_000 --model m.morph -o out", "'zz'; expected 3, frame_000 Correct"),
    ("mimic --src anna.morph --dst ben.morph -o out --neutral zz", "anna 'zz'; frame_000 Correct"),
    ("flow a.png b.png -o o.flo --preset best", "--preset 'best'; expected one or more of fast, balanced"),
    ("flow a.png b.png -o .", ".flo .exr"),
    ("flow a.png b.png -o / --both", ".flo .exr"),
    ("encode plain.morph clip -o .", ".csv output.csv"),
    ("encode plain.morph clip -o /", ".csv output.csv"),
    ("encode plain.morph clip -o clip/..", "clip/.. output.csv"),
    ("build-model clip -o .", ".morph output.morph"),
    ("build-model clip --landmarks nowhere.csv", "nowhere.csv"),
    ("build-model clip --landmarks never", "never .csv .tem"),
    ("build-model clip --landmarks nan.csv", "nan.csv line x_px 'nan' number"),
    ("encode m.morph clip -o o.csv --landmarks nan.csv", "nan.csv x_px 'nan'"),
    ("encode m.morph clip -o o.csv --landmarks t.csv", "t.json format"),
    ("track clip -o t.csv", "models fetch"),
    ("track clip -o p.tsv", "models fetch"),
    ("track nowhere -o p.csv", "nowhere"),
    ("track clip -o p.csv --from nan.csv", "nan.csv x_px 'nan'"),
    ("track clip -o p.csv --from clip", "clip .tem"),
    ("build-model clip -o x.morph --report .", ".html output.html"),
    ("blend-avatar anna.morph ben.morph -o .", ".morph output.morph"),
    ("blend-avatar anna.morph ben.morph -o /", ".morph output.morph"),
    ("keypoints plain.morph --set 20,30|41,29|30,44 -o .", ".morph output.morph"),
    ("info m.morph --loadings /", ".csv output.csv"),
    ("trajectory m.morph t.csv --op reverse -o a.png/in", "a.png file; folder Choose"),
    ("sample m.morph -o a.png", "a.png file; expected folder. Choose"),
    ("sample m.morph -o dangling/x", "dangling link nothing; expected folder. Choose"),
    ("caricature m.morph -o out", "neither was given"),
    ("caricature m.morph --loadings t.csv --clip x -o out", "both were given"),
    ("caricature m.morph --loadings t.csv --gain 1,x -o out", "1,x"),
    ("caricature m.morph --loadings t.csv --gain inf -o out", "--gain 'inf' list"),
    ("caricature m.morph --loadings t.csv --gain 1e9 -o out", "most 1000"),
    ("caricature m.morph --loadings t.csv --components 2-9 -o out", "2-9 1 3"),
    ("caricature m.morph --loadings t.csv --region eyes -o out", "keypoints"),
    ("caricature m.morph --loadings t.csv --region no.png -o out", "no.png"),
    ("caricature m.morph --loadings t.csv --frame zz -o out", "'zz' frame_000"),
    ("grid m.morph --components 1 4 -o out", "1 4 3"),
    ("sample m.morph --max-sd 0.001 -o out", "0.001"),
    ("place m.morph nowhere -o out", "nowhere"),
    ("replay t.csv", "JSON"),
    ("render m.morph t.csv -o x.avi", "x.avi"),
    ("batch recipe.yaml -o out --workers 0", "--workers"),
    ("batch recipe.yaml -o out --worker 2", "--worker"),
    ("batch recipe.yaml", "-o"),
    ("info m.morph --workers 0", "--workers 0 1 1,024"),
    ("info m.morph --workers 2.5", "--workers 2.5 whole number"),
    ("trajectory m.morph t.csv -o out --op dance", "'dance'; smooth, speed, Choose"),
    ("trajectory m.morph t.csv -o out --op smoth=2", "'smoth'; Did smooth=HZ?"),
    ("trajectory m.morph t.csv -o out --op timing", "timing: guide --guide"),
    ("trajectory m.morph t.csv -o out --op speed=x", "speed 'x'; number speed=TIMES"),
    ("trajectory m.morph t.csv -o out --op speed", "speed no numbers; speed=TIMES"),
    ("trajectory m.morph t.csv -o out --op splice", "splice 1 motion; 2 tables"),
    ("trajectory m.morph t.csv -o out --op caricature=2", "one motion guide; 2 tables --guide;"),
    ("trajectory m.morph t.csv -o out --op reverse --guide t.csv", "guide timing caricature."),
    ("trajectory m.morph t.csv -o out --op part=5:6", "part=5:6: 0 frames; 2."),
    ("measure-mimicry t.csv t.csv --model m.morph --imitator m.morph -o out", "--imitator m.morph itself;"),
    ("mimic --src m.morph --dst m.morph -o out --gain much", "much number auto"),
    ("mimic --src anna.morph --dst ben.morph -o |", "-o empty"),
    ("demo -o |", "--output empty"),
    ("keypoints plain.morph --set 1,2|3,4", "3 pairs numbers"),
    ("keypoints plain.morph --set 1,2|3,4|5,x", "3 pairs numbers"),
    ("keypoints plain.morph --set 1,2|3,4|nan,5", "3 pairs numbers"),
    ("keypoints plain.morph --set 20,30|41,29|30,144", "philtrum 30.0,144.0 60x72"),
    ("keypoints plain.morph --set 20,30|20,30|30,44", "both eyes 20,30"),
    ("keypoints plain.morph --set 20,30|41,29|90,44 --on reference", "reference 64x80"),
    ("keypoints plain.morph --set 20,30|41,29|30,44 --auto", "--auto --set"),
    ("keypoints plain.morph --set 20,30|41,29|30,44 --negate-y", "--negate-y --from"),
    ("keypoints plain.morph --auto --lip upper-lip", "--auto philtrum"),
    ("keypoints plain.morph --lip upper-lip", "no keypoints"),
    ("keypoints plain.morph --from nowhere.csv", "nowhere.csv"),
    ("keypoints plain.morph --set 20,30|41,29|30,44 -o other.png", ".morph"),
    ("blend-avatar anna.morph -o out/x.morph", "least 2"),
    ("blend-avatar anna.morph plain.morph -o out/x.morph", "keypoints"),
    ("blend-avatar anna.morph gone.morph -o out/x.morph", "gone.morph"),
    ("blend-avatar anna.morph ben.morph -o ben.morph", "ben.morph replaced"),
    ("blend-avatar anna.morph ben.morph -o out/x.morph --weights 1,2,3", "3 weights"),
    ("blend-avatar anna.morph ben.morph -o out/x.morph --weights 0,0", "sum 0"),
    ("blend-avatar anna.morph ben.morph -o out/x.morph --weights 1,x", "1,x list"),
    ("blend-avatar anna.morph ben.morph -o out/x.morph --weights 1e308,1e308", "smaller"),
    ("blend-avatar anna.morph ben.morph -o out/x.morph --identity ||", "--identity empty"),
    ("blend-avatar anna.morph ben.morph -o out/x.morph --sharpen 10", "0 3"),
    ("blend-avatar anna.morph ben.morph -o out/x.morph --expressions few", "few all"),
    ("blend-avatar anna.morph ben.morph -o out/x.morph --expressions 0", "0 1"),
    ("blend-avatar anna.morph ben.morph -o out/x.morph --expressions 1 --weights 1,0", "1 3"),
    ("blend-avatar anna.morph ben.morph -o out/x.morph --sharpen 3.1", "3.1 0 3"),
    ("blend-avatar anna.morph ben.morph -o out/x.morph --components 0", "0 1"),
    ("blend-avatar anna.morph ben.morph -o out/x.morph --surround carl", "'carl'; flat, anna, ben."),
    ("blend-avatar anna.morph ben.morph -o out/x.morph --max-sd 0", "--max-sd 0; 0.001 1,000"),
)


@pytest.mark.parametrize(("words", "named"), BAD)
def test_bad_words_get_one_line_and_change_nothing(lab, monkeypatch, tmp_path, words, named):
    monkeypatch.chdir(lab)
    monkeypatch.setenv("MORPHSPACE_MODELS", str(tmp_path))
    before = files_of(lab)
    given = ["" if word == "|" else word.replace("|", " ") for word in words.split()]
    result = CliRunner().invoke(main, given)
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("morphspace: ") and result.stderr.count("\n") == 1, result.stderr
    assert [word for word in named.split(" ") if word not in result.stderr] == []
    assert files_of(lab) == before


def files_of(folder: Path) -> dict[Path, tuple[int, int]]:
    found = {path: path.lstat() for path in folder.rglob("*")}
    return {path: (is_there.st_size, is_there.st_mtime_ns) for path, is_there in found.items()}
