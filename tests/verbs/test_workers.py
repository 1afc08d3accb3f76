"""A law of verbs that work on many frames: any number of workers writes the same bytes."""

import pytest
from click.testing import CliRunner

from morphspace.cli.main import main
from morphspace.outcome import Outcome
from morphspace.steps import Step, result_of, using_workers, worker_count
from morphspace.verbs import build_model, encode, info, make_actors, mimic


@pytest.fixture(scope="module")
def actors(tmp_path_factory):
    folder = tmp_path_factory.mktemp("actors")
    request = make_actors.MakeActorsRequest(output=folder, identities=2, frames=7, size=(60, 72))
    result_of(make_actors.run(request))
    return [folder / "actor_01", folder / "actor_02"]


def bytes_in(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_building_encoding_and_mimicry_give_the_same_bytes_for_any_number_of_workers(
    actors, tmp_path, monkeypatch
):
    monkeypatch.setenv("MORPHSPACE_MODELS", str(tmp_path / "none"))
    made = []
    for count in (1, 2, 5):
        folder = tmp_path / str(count)
        folder.mkdir()
        monkeypatch.chdir(folder)
        with using_workers(count):
            for name, clip in zip("ab", actors, strict=True):
                request = build_model.BuildModelRequest(sources=(str(clip),), output=folder / f"{name}.morph")
                result_of(build_model.run(request))
            request = encode.EncodeRequest(
                model=folder / "a.morph", sources=(str(actors[0]),), output=folder / "a.csv"
            )
            result_of(encode.run(request))
            request = mimic.MimicRequest(
                source=str(folder / "a.morph"),
                target=str(folder / "b.morph"),
                output=folder / "mimicry",
                frames=str(actors[0]),
            )
            result_of(mimic.run(request))
        made.append(bytes_in(folder))
    assert made[0].keys() == made[1].keys() == made[2].keys()
    for name, content in made[0].items():
        assert content == made[1][name] == made[2][name], name


def test_the_option_says_how_many_workers_there_are(monkeypatch, tmp_path):
    def run(request):
        yield Step("look", 1, 1)
        return Outcome((f"{worker_count()} workers",))

    monkeypatch.setattr(info, "run", run)
    monkeypatch.setenv("MORPHSPACE_WORKERS", "7")
    (tmp_path / "a.morph").touch()
    for words, count in (([], 7), (["--workers", "3"], 3)):
        result = CliRunner().invoke(main, ["info", str(tmp_path / "a.morph"), *words])
        assert result.output == f"{count} workers\n"
