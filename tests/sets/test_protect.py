"""The guard of outputs: what a verb may replace, and what a stopped or simultaneous run finds."""

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from morphspace import notebook
from morphspace.errors import BadInput, UnwritableFile
from morphspace.io.images import write_image
from morphspace.io.stimulus_sidecars import sidecar_text
from morphspace.io.tables import write_loadings_table
from morphspace.outcome import write_record
from morphspace.requests import OUTPUT, all_verbs, verb_named
from morphspace.sets import stimulus as stimulus_room
from morphspace.sets.marks import locked
from morphspace.sets.outputs import Output, check_work_folder, set_output
from morphspace.sets.protect import check_origins, writing
from morphspace.steps import result_of
from morphspace.storage import MARK_NAME, unfinished_in, whole_file, write_container, write_text


def bytes_of(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def folder_output(folder, verb="mimic", names=("frames", "table.csv", "record.json"), **more):
    return Output(verb, folder, [folder / name for name in names], **more)


def complete(output):
    """Write every file of an output, as a verb does."""
    with writing(output):
        written = []
        for path in output.files:
            if path == output.record:
                continue
            target = path / "one.txt" if path.name == "frames" else path
            write_text(target, "ours")
            written.append(target)
        write_record(output.folder, output.verb, {}, {}, written, output.record.name)


def test_a_finished_run_leaves_no_mark_and_its_files_are_replaced(tmp_path):
    output = folder_output(tmp_path / "out")
    complete(output)
    assert set(bytes_of(tmp_path / "out")) == {"frames/one.txt", "table.csv", "record.json"}
    complete(output)


@pytest.mark.parametrize("name", ["table.csv", "frames/mine.png", "record.json"])
def test_a_file_of_another_origin_is_refused_and_stays(tmp_path, name):
    mine = tmp_path / "out" / name
    mine.parent.mkdir(parents=True)
    mine.write_bytes(b"mine")
    with pytest.raises(BadInput, match=f"{name} is a file that no earlier mimic wrote"):
        complete(folder_output(tmp_path / "out"))
    assert bytes_of(tmp_path / "out") == {name: b"mine"}


def test_the_files_of_another_verb_are_of_another_origin(tmp_path):
    complete(folder_output(tmp_path, "reconstruct"))
    with pytest.raises(BadInput, match="no earlier mimic wrote"):
        complete(folder_output(tmp_path, "mimic"))


@pytest.mark.parametrize("name", ["table.csv", "frames/one.txt"])
def test_a_file_that_was_changed_since_is_refused_and_stays(tmp_path, name):
    complete(folder_output(tmp_path))
    (tmp_path / name).write_bytes(b"ours, with ratings of mine")
    with pytest.raises(BadInput, match=f"{name} is a file .* or that was changed since"):
        complete(folder_output(tmp_path))
    assert (tmp_path / name).read_bytes().endswith(b"mine")


def test_files_of_an_earlier_run_that_the_next_does_not_write_go_unless_they_were_changed(tmp_path):
    output = folder_output(tmp_path)
    with writing(output):
        for name in ("one.txt", "two.txt"):
            write_text(tmp_path / "frames" / name, name)
        write_record(tmp_path, "mimic", {}, {}, sorted((tmp_path / "frames").iterdir()))
    complete(output)
    assert set(bytes_of(tmp_path)) == {"frames/one.txt", "table.csv", "record.json"}


def test_a_file_with_the_name_of_the_mark_is_refused_and_stays(tmp_path):
    (tmp_path / MARK_NAME).write_bytes(b"mine")
    with pytest.raises(BadInput, match="no earlier mimic wrote"):
        complete(folder_output(tmp_path))
    assert bytes_of(tmp_path) == {MARK_NAME: b"mine"}


def test_a_set_is_not_written_into_a_clip_or_among_pictures(tmp_path):
    stimuli = [(tmp_path / "a.png", tmp_path / "a.json")]
    (tmp_path / "clip.json").write_text('{"identity": "anna"}')
    with pytest.raises(BadInput, match="is a clip"):
        complete(folder_output(tmp_path))
    (tmp_path / "clip.json").unlink()
    (tmp_path / "photo.jpg").write_bytes(b"mine")
    with pytest.raises(BadInput, match=r"no stimuli, such as photo\.jpg"):
        complete(folder_output(tmp_path, "sample", ("record.json",), stimuli=stimuli))
    with pytest.raises(BadInput, match="holds the input frames"):
        complete(folder_output(tmp_path, inputs=[tmp_path / "photo.jpg"]))
    assert set(bytes_of(tmp_path)) == {"photo.jpg"}


@pytest.mark.parametrize("name", ["faces.mp4", "face.PNG", "faces.gif"])
def test_a_folder_is_not_named_like_a_picture_or_video(tmp_path, name):
    """`place -o faces.mp4` made a folder of this name, where a video was expected."""
    with pytest.raises(
        BadInput, match=rf"{name} is a folder, but its name ends in .*; expected a name without"
    ):
        complete(folder_output(tmp_path / name))
    assert not list(tmp_path.iterdir())
    complete(folder_output(tmp_path / "faces.v2"))


def test_a_table_of_another_person_and_one_of_a_set_are_refused(tmp_path):
    path = tmp_path / "a.csv"
    write_loadings_table(path, np.ones((1, 1)), ["f"], {"identity": "anna"})
    for identity, found in (("anna", None), ("ben", "is of anna")):
        output = Output("encode", path, [path, path.with_suffix(".json")], identity=identity)
        if found is None:
            check_origins(output)
        else:
            with pytest.raises(BadInput, match=found):
                check_origins(output)
    write_record(tmp_path, "sample", {}, {}, [path])
    with pytest.raises(BadInput, match="no earlier encode wrote"):
        check_origins(single(path))


def test_a_file_put_where_a_killed_run_would_have_written_stays(tmp_path):
    started = run_until_killed(tmp_path, "os._exit(9)")
    started.communicate()
    (tmp_path / "table.csv").write_bytes(b"mine")
    with pytest.raises(BadInput, match="no earlier mimic wrote"):
        complete(folder_output(tmp_path))
    assert (tmp_path / "table.csv").read_bytes() == b"mine"


@pytest.mark.parametrize("name", [".DS_Store", "Thumbs.db"])
def test_files_of_the_system_and_empty_files_hinder_nothing(tmp_path, name):
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / name).write_bytes(b"system")
    (tmp_path / "table.csv").touch()
    complete(folder_output(tmp_path))


def test_a_folder_with_the_name_of_a_file_is_refused(tmp_path):
    (tmp_path / "table.csv" / "inner").mkdir(parents=True)
    with pytest.raises(BadInput, match=r"table\.csv is a folder that no earlier mimic wrote"):
        complete(folder_output(tmp_path))


def run_verb(verb, **given):
    found = verb_named(verb)
    return result_of(found.run(found.request(**given)))


def single(path, verb="encode"):
    return Output(verb, path, [path])


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.csv", b"x,y\n"),
        ("a.html", b"<html></html>"),
        ("a.morph", b"text"),
        ("a.json", b'{"format": "mine"}'),
    ],
)
def test_a_single_file_is_recognised_by_its_content(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(BadInput, match="no earlier encode wrote"), writing(single(path)):
        pytest.fail("the guard let the block run")
    assert bytes_of(tmp_path) == {name: content}


def test_files_with_the_marks_of_morphspace_are_replaced(tmp_path):
    write_loadings_table(tmp_path / "a.csv", np.ones((1, 1)), ["f"], {})
    (tmp_path / "a.html").write_text("<p>x</p><footer>Written by morphspace. It loads nothing.</footer>")
    write_container(tmp_path / "a.morph", {}, {"format": "morphspace-model"})
    cut = (tmp_path / "a.morph").read_bytes()[:60]
    (tmp_path / "b.morph").write_bytes(cut)
    for name in ("a.csv", "a.json", "a.html", "a.morph", "b.morph"):
        with writing(single(tmp_path / name)):
            pass


def test_the_files_of_a_failed_run_are_taken_over_and_one_without_files_leaves_nothing(tmp_path):
    output = folder_output(tmp_path / "deep" / "out")
    with pytest.raises(KeyboardInterrupt), writing(output):
        raise KeyboardInterrupt
    assert not (tmp_path / "deep").exists()
    with pytest.raises(KeyboardInterrupt), writing(output):
        write_text(output.folder / "frames" / "half.png", "ours")
        raise KeyboardInterrupt
    assert (output.folder / MARK_NAME).is_file()
    check_origins(output)
    with pytest.raises(BadInput, match="no earlier reconstruct wrote"):
        check_origins(folder_output(output.folder, "reconstruct"))
    complete(output)
    assert not (output.folder / MARK_NAME).exists()


def run_until_killed(folder, then):
    """Run the guard in another process, and return it once it is inside the block."""
    code = f"""
        import os, sys, time
        from pathlib import Path
        from morphspace.sets.outputs import Output
        from morphspace.sets.protect import writing
        from morphspace.storage import write_text
        folder = Path({str(folder)!r})
        with writing(Output("mimic", folder, [folder / "frames", folder / "table.csv", folder / "record.json"])):
            write_text(folder / "table.csv", "half done")
            (folder / ".table.morphspace-abcdefgh.csv").write_bytes(b"unfinished")
            (folder / ".table.abcdefgh.csv").write_bytes(b"of another program")
            print("inside", flush=True)
            {then}
    """
    started = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)], stdout=subprocess.PIPE, env=dict(os.environ)
    )
    assert started.stdout.readline() == b"inside\n"
    return started


def test_a_killed_run_is_recognised_and_its_unfinished_files_go(tmp_path):
    started = run_until_killed(tmp_path, "os._exit(9)")
    started.communicate()
    assert json.loads((tmp_path / MARK_NAME).read_text().splitlines()[0])["process"] == started.pid
    complete(folder_output(tmp_path))
    assert set(bytes_of(tmp_path)) == {
        "frames/one.txt",
        "table.csv",
        "record.json",
        ".table.abcdefgh.csv",
    }


def test_a_second_run_names_the_first_and_changes_nothing(tmp_path):
    started = run_until_killed(tmp_path, "time.sleep(60)")
    before = bytes_of(tmp_path)
    try:
        with pytest.raises(BadInput, match=rf"another mimic \(process {started.pid}\) is writing"):
            complete(folder_output(tmp_path))
        assert bytes_of(tmp_path) == before
    finally:
        started.kill()
        started.communicate()
    complete(folder_output(tmp_path))


def test_two_files_of_one_folder_are_written_at_once(tmp_path):
    with writing(single(tmp_path / "a.csv")), writing(single(tmp_path / "b.csv")):
        pass
    with (
        pytest.raises(BadInput, match="another encode"),
        writing(single(tmp_path / "a.csv")),
        writing(single(tmp_path / "a.csv")),
    ):
        pass
    assert not bytes_of(tmp_path)


def test_a_mark_that_is_a_link_is_not_followed(tmp_path):
    (tmp_path / "victim").write_bytes(b"mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / MARK_NAME).symlink_to(tmp_path / "victim")
    with pytest.raises(UnwritableFile, match="cannot write"):
        complete(folder_output(tmp_path / "out"))
    assert (tmp_path / "victim").read_bytes() == b"mine"


WITH_OUTPUT = [verb for verb in all_verbs() if OUTPUT in verb.request.__dataclass_fields__]


@pytest.mark.parametrize("verb", WITH_OUTPUT, ids=lambda verb: verb.name)
def test_every_verb_with_an_output_asks_the_guard(verb):
    """The file of the verb enters `writing`, or hands its set to a function that does; replay writes new names only."""
    source = Path(verb.module.__file__).read_text(encoding="utf-8")
    assert verb.name == "replay" or any(word in source for word in ("writing(", "write_set(", "write_batch("))


def test_a_picture_that_cannot_be_read_is_drawn_again_and_one_put_in_its_place_stays(tmp_path):
    picture = tmp_path / "frames" / "one.png"
    output = folder_output(tmp_path)
    with writing(output):
        write_image(picture, np.zeros((4, 4, 3), np.float32))
        write_record(tmp_path, "mimic", {}, {}, [picture])
    picture.write_bytes(picture.read_bytes()[:-5])
    check_origins(output)
    write_image(picture, np.ones((4, 4, 3), np.float32))
    with pytest.raises(BadInput, match="changed since"):
        check_origins(output)


def test_whole_files_have_temporary_names_that_are_recognised(tmp_path):
    with whole_file(tmp_path / "a table of loadings with quite a long name of its own.csv") as temporary:
        assert list(unfinished_in(tmp_path)) == [temporary]
        assert ".morphspace-" in temporary.name and temporary.suffix == ".csv"
    assert not list(unfinished_in(tmp_path))


def stimuli_of(folder, names=("a", "b")):
    return [(folder / f"{name}.png", folder / f"{name}.json") for name in names]


def test_what_a_killed_run_of_another_verb_left_unfinished_goes_unless_others_write_here(tmp_path):
    hidden = tmp_path / ".pc001_+1sd.morphspace-abcdefgh.png"
    first = set_output("sweep", tmp_path, [])
    with locked(first) as mark:
        mark.begin({})
        hidden.write_bytes(b"half")
        (tmp_path / ".mine.png").write_bytes(b"mine")
    with writing(single(tmp_path / "t.csv")), writing(set_output("sample", tmp_path, [])):
        assert hidden.exists()  # it may be that of the other run
    with locked(first) as mark:
        mark.begin({})
    with writing(set_output("sample", tmp_path, [])):
        pass
    assert set(bytes_of(tmp_path)) == {".mine.png"}


@pytest.fixture
def drawn(model, tmp_path):
    """The output of a set of two stimuli, drawn with its record, and the function that draws it again."""
    model.save(tmp_path / "m.morph")
    verb = verb_named("sample")

    def draw(seed=1):
        given = {"model": tmp_path / "m.morph", "output": tmp_path / "set", "count": 2, "seed": seed}
        return result_of(verb.run(verb.request(**given)))

    draw()
    return tmp_path / "set", draw


def edited(sidecar, change):
    document = json.loads(sidecar.read_text())
    change(document)
    sidecar.write_text(sidecar_text(document))


@pytest.mark.parametrize("has_record", [True, False])
@pytest.mark.parametrize(
    "change",
    [
        lambda document: document.update(note="the best of all"),
        lambda document: document.update(consent="withdrawn"),
        lambda document: document["drawing"]["variables"].update(rating=5),
    ],
)
def test_an_edited_sidecar_is_refused_and_stays(drawn, change, has_record):
    folder, draw = drawn
    if not has_record:
        (folder / "record.json").unlink()
        (folder / "manifest.csv").unlink()
        for path in folder.glob("*.json"):
            if not path.name.startswith("sample"):
                path.unlink()
        (folder / "index.html").unlink()
        (folder / "loadings.csv").unlink()
    edited(folder / "sample_0001.json", change)
    before = bytes_of(folder)
    for seed in (1, 2):
        with pytest.raises(
            BadInput, match=r"sample_0001\.json was changed since it was written.*Keep notes in a file"
        ):
            draw(seed)
    assert bytes_of(folder) == before
    (folder / "sample_0001.json").unlink()
    draw(2)


def test_a_sidecar_in_other_words_is_an_edited_one(drawn):
    folder, draw = drawn
    path = folder / "sample_0000.json"
    path.write_text(json.dumps(json.loads(path.read_text())))
    with pytest.raises(BadInput, match="was changed since"):
        draw(2)


def test_unedited_sidecars_are_replaced_also_those_that_a_stopped_run_has_replaced(drawn):
    folder, draw = drawn
    before = bytes_of(folder)
    draw(2)
    after = bytes_of(folder)
    assert before["sample_0000.json"] != after["sample_0000.json"]
    (folder / "record.json").write_bytes(before["record.json"])  # as if stopped before its record
    with locked(set_output("sample", folder, [])) as mark:
        mark.begin({})
    (folder / "manifest.csv").write_bytes(before["manifest.csv"])
    for name in ("index.html", "manifest.json", "loadings.csv", "loadings.json"):
        if name in before:
            (folder / name).write_bytes(before[name])
    draw(3)


@pytest.mark.parametrize("content", ["clip.json", "a.png", "take.mp4", "frames/a.jpg"])
def test_a_work_folder_is_no_clip(tmp_path, content):
    (tmp_path / "work" / content).parent.mkdir(parents=True)
    (tmp_path / "work" / content).write_bytes(b"x")
    for check in (
        lambda: check_work_folder(tmp_path / "work"),
        lambda: notebook._work_folder(tmp_path / "work"),
        lambda: run_verb("build-model", sources="actor", output="m.morph", work_folder=tmp_path / "work"),
        lambda: run_verb(
            "blend-avatar", models="a.morph;b.morph", output="m.morph", work_folder=tmp_path / "work"
        ),
    ):
        with pytest.raises(BadInput, match=r"the work folder .*work is a clip \(it holds"):
            check()
    check_work_folder(None)
    check_work_folder(tmp_path / "nowhere")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "ab.kept").write_bytes(b"x")
    check_work_folder(tmp_path / "other")


def test_a_figure_in_a_sidecar_or_a_picture_that_was_changed_since_the_record_is_refused(drawn):
    folder, draw = drawn
    sidecar, picture = folder / "sample_0000.json", folder / "sample_0000.png"
    whole = sidecar.read_bytes()
    edited(sidecar, lambda document: document["statistics"]["code"].update(luminance=0.25))
    with pytest.raises(BadInput, match=r"sample_0000\.json was changed since it was written"):
        draw(2)
    sidecar.write_bytes(whole)
    (folder / "sample_0000.png").write_bytes((folder / "sample_0001.png").read_bytes())
    with pytest.raises(BadInput, match=r"sample_0000\.png was changed since it was written"):
        draw(2)
    picture.write_bytes(picture.read_bytes()[:-20])  # damaged
    draw(2)


def test_a_run_that_stopped_among_its_stimuli_is_taken_over(drawn, monkeypatch):
    folder, draw = drawn
    write, made = stimulus_room.write_text, []

    def full(path, text):
        made.append(path)
        if len(made) == 2:
            raise UnwritableFile("full")
        write(path, text)

    monkeypatch.setattr(stimulus_room, "write_text", full)
    with pytest.raises(UnwritableFile):
        draw(2)
    assert (folder / MARK_NAME).exists()
    monkeypatch.undo()
    draw(3)
    assert not (folder / MARK_NAME).exists()
