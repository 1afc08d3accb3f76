"""Requests: Python, the command line and recipes take and refuse the same values, with the same words."""

import subprocess
import sys
from dataclasses import MISSING, fields
from pathlib import Path

import click
import pytest
from annotated_types import Ge, Gt, Le
from hypothesis import given, settings
from hypothesis import strategies as st

from morphspace.avatar import AvatarSettings
from morphspace.cli.main import SharedRequest, main
from morphspace.cli.options import parameters_of, request_of_words
from morphspace.errors import BadInput
from morphspace.model.from_clip import ClipSettings
from morphspace.requests import all_verbs, fields_of, request_from, settings_of, verb_named, verb_names
from morphspace.sets.imitation import MeasureSettings
from morphspace.sets.mimicry import MimicSettings
from morphspace.settings import Option, WrongSetting
from morphspace.verbs.blend_avatar import BlendAvatarRequest
from morphspace.verbs.build_model import BuildModelRequest
from morphspace.verbs.measure_mimicry import MeasureMimicryRequest
from morphspace.verbs.mimic import MimicRequest

VERBS = list(all_verbs())
SETTINGS = [
    (verb, field)
    for verb in VERBS
    for field in settings_of(verb.request)
    if field.spoken and field.kind is not bool
]
WORDS = st.one_of(
    st.sampled_from(["", " ", "auto", "mkv", ".mp4", "0", "1", "-1", "0.5", "1e3", "nan", "inf", "1,2", "200x240"]),
    st.text("0123456789.,;x-+e a", max_size=9),
    st.integers(-10, 10**6).map(str),
)  # fmt: skip


def needed(request):
    """Give values for what has no default, so that one setting can be tried by itself."""
    return {
        field.name: ("a",) if field.word_count is None else "a"
        for field in fields_of(request)
        if field.required
    }


def outcome_of(make):
    """Give the request or what is said against it, without the name of the setting."""
    try:
        return make()
    except WrongSetting as error:
        return error.rest
    except click.UsageError as error:
        return "is " + error.message.partition(" is ")[2]
    except BadInput as error:  # settings that do not go together
        return str(error)


def on_the_command_line(request, name, words):
    context = click.Context(click.Command("v", params=parameters_of(request)))
    given = {**needed(request), name: words}
    for key in given:
        context.set_parameter_source(key, click.core.ParameterSource.COMMANDLINE)
    with context:
        return request_of_words(request, given)


@settings(deadline=None, max_examples=400)
@given(st.sampled_from(SETTINGS), WORDS)
def test_python_the_command_line_and_a_recipe_take_and_refuse_alike(setting, word):
    verb, field = setting
    if word == "none" or field.gives:
        return
    value = word if field.word_count == 1 else (word,) * (field.word_count or 1)
    given = {**needed(verb.request), field.name: value}
    written = {
        name: list(one) if isinstance(one, tuple) else one for name, one in given.items() if name != "output"
    }
    output = {"output": given["output"]} if "output" in given else {}
    python = outcome_of(lambda: verb.request(**given))
    assert outcome_of(lambda: on_the_command_line(verb.request, field.name, value)) == python
    recipe = outcome_of(lambda: request_from(verb.request, written, **output))
    if (
        isinstance(recipe, str) and "Replace the commas" in recipe
    ):  # 1,5 in a spreadsheet's cell is one number
        assert "," in word and field.values[-1] is Ellipsis
    else:
        assert recipe == python


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.name)
def test_a_number_at_its_limit_is_taken_and_beyond_it_is_refused(verb):
    for field in settings_of(verb.request):
        for mark in field.marks:
            if not isinstance(mark, Ge | Gt | Le):
                continue
            limit = getattr(mark, type(mark).__name__.lower())
            beyond = limit + (1 if isinstance(mark, Le) else -1)
            with pytest.raises(WrongSetting, match=field.name):
                verb.request(**{**needed(verb.request), field.name: beyond})
            if not isinstance(mark, Gt):
                taken = outcome_of(
                    lambda f=field, value=limit: verb.request(**{**needed(verb.request), f.name: value})
                )
                assert not isinstance(taken, str) or "expected" not in taken


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.name)
def test_every_setting_has_help_and_options_of_its_own(verb):
    taken = ["--help", "-h"]
    for field in (*fields_of(verb.request), *fields_of(SharedRequest)):
        assert field.help, field.name
        if field.argument is None and field.spoken:
            taken += field.flags
    assert len(taken) == len(set(taken))
    assert not verb.help.startswith(f"{verb.request.__name__}("), "a dataclass without a docstring"


def test_a_build_inside_mimic_has_the_defaults_of_build_model():
    defaults = {field.name: field.default for field in fields_of(BuildModelRequest) if not field.required}
    for one in fields(ClipSettings):
        assert one.default == defaults[one.name], one.name


@pytest.mark.parametrize(
    ("request_type", "room"),
    [
        (BlendAvatarRequest, AvatarSettings),
        (MimicRequest, MimicSettings),
        (MeasureMimicryRequest, MeasureSettings),
    ],
)
def test_defaults_that_a_request_declares_are_declared_there_alone(request_type, room):
    declared = {field.name for field in fields_of(request_type)} - {"clips"}  # opened, no longer names
    assert [one.name for one in fields(room) if one.name in declared and one.default is not MISSING] == []


def test_the_list_of_verbs_is_the_list_of_their_files():
    folder = Path(sys.modules[VERBS[0].request.__module__].__file__).parent
    assert len(verb_names()) == len(list(folder.glob("*.py"))) - 1 == len(VERBS)
    with pytest.raises(BadInput, match=f"the verb is 'dream'; expected one of {verb_names()[0]}"):
        verb_named("dream")
    commands = main.list_commands(click.Context(main))
    assert set(commands) == {name.partition(" ")[0] for name in verb_names()}


def test_a_declaration_imports_nothing_heavy():
    code = (
        "import sys\n"
        "from morphspace.requests import all_verbs, fields_of\n"
        "[fields_of(verb.request) for verb in all_verbs()]\n"
        "print(sorted({'numpy', 'cv2', 'scipy', 'torch', 'av', 'tqdm', 'click'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_an_option_says_its_name_and_a_setting_its_own():
    assert Option("-n", "--count").flags == ("-n", "--count")
    sample = verb_named("sample").request
    assert [field.spoken for field in fields_of(sample)][:3] == ["MODEL", "--output", "--count"]
