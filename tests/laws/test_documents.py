"""JSON documents: what a declaration describes is taken, all else is refused in one line, and the schema agrees."""

import json
import re
import typing
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, TypedDict

import jsonschema
import numpy as np
import pytest
from annotated_types import Ge, Gt, Le, Len
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from morphspace.cli.documents import DOCUMENTS, schema_text
from morphspace.documents import (
    Digests,
    Document,
    Holds,
    OneLength,
    Open,
    OrNull,
    Point,
    entries_of,
    read_json_object,
)
from morphspace.errors import BadInput, ModelFileError, UnreadableFile
from morphspace.io.png import png_with_texts
from morphspace.io.sidecars import (
    POINT_NAMES,
    MarkedFaceframe,
    Sidecar,
    read_faceframe,
    read_sidecar,
    write_sidecar,
)
from morphspace.io.stimulus_sidecars import KEYWORD, essentials_in
from morphspace.io.tables import read_loadings_table, write_loadings_table
from morphspace.model.keypoints import framing_of, landmarks_of, lip_of
from morphspace.model.model import load_model
from morphspace.outcome import RECORD
from morphspace.sets.replay import replayed
from morphspace.settings import OneOf, Pattern, is_union, kind_and_marks, mark_of
from morphspace.steps import result_of
from morphspace.storage import json_text, read_container, write_container
from morphspace.verbs import sample
from morphspace.verbs.sample import SampleRequest

ROOT = Path(__file__).parents[2]


class Inner(TypedDict):
    side: Annotated[int, Gt(0), Le(9)]
    name: NotRequired[OrNull[Annotated[str, Pattern("[a-z]+", "small letters")]]]


class Example(TypedDict):
    format: Literal["morphspace-example"]
    version: Literal[1]
    inner: OrNull[Inner]
    points: Annotated[list[Point], Len(1)]
    rows: NotRequired[Annotated[list[list[float]], OneLength()]]
    digests: NotRequired[Digests]
    packages: NotRequired[Annotated[dict[str, str], Holds(("python",)), Len(1)]]
    share: NotRequired[Annotated[float, Ge(0), Le(1)] | Literal["auto"] | bool]
    part: NotRequired[Annotated[str, OneOf(("eyes", "mouth"))]]


EXAMPLE = Document("example", "an example", Example, "Correct it")
RIGHT = {"format": "morphspace-example", "version": 1, "inner": None, "points": [[1, 2.5]]}


@pytest.mark.parametrize(
    ("entry", "value", "words"),
    [
        ("format", "other", 'format is "other"; expected morphspace-example. Correct it'),
        ("version", True, "version is true; expected 1. Install the morphspace that wrote it"),
        ("version", 2, "version is 2; expected 1. Install the morphspace that wrote it"),
        ("inner", ..., "inner is missing; expected an object or null. Correct it"),
        ("inner", 3, "inner is 3; expected an object or null. Correct it"),
        ("inner", {}, "inner.side is missing; expected a whole number above 0, up to 9. Correct it"),
        ("inner", {"side": "3"}, 'inner.side is "3"; expected a whole number above 0, up to 9. Correct it'),
        ("inner", {"side": True}, "inner.side is true; expected a whole number above 0, up to 9. Correct it"),
        ("inner", {"side": 3.0}, "inner.side is 3.0; expected a whole number above 0, up to 9. Correct it"),
        ("inner", {"side": 10}, "inner.side is 10; expected a whole number above 0, up to 9. Correct it"),
        ("inner", {"side": 1, "name": "A"}, 'inner.name is "A"; expected small letters or null. Correct it'),
        ("inner", {"side": 1, "x": 1}, "inner.x is unknown; expected only side, name. Correct it"),
        ("points", [], "points is []; expected a list of pairs of numbers, 1 or more. Correct it"),
        ("points", [[1, 2], [3]], "points[1] is [3]; expected [x, y] in px. Correct it"),
        ("points", [[True, 2]], "points[0][0] is true; expected a number. Correct it"),
        ("points", [[1, None]], "points[0][1] is null; expected a number. Correct it"),
        ("rows", [[1, 2], [3]], "rows[1] has 1 values; expected 2 as in the first row. Correct it"),
        ("digests", {"a": "b"}, 'digests.a is "b"; expected a SHA-256 of 64 hexadecimal digits. Correct it'),
        ("packages", {}, "packages.python is missing; expected a text. Correct it"),
        ("share", 1.5, "share is 1.5; expected a number from 0 to 1 or auto or true or false. Correct it"),
        ("part", "ear", 'part is "ear"; expected one of eyes, mouth. Correct it'),
    ],
)
def test_a_wrong_entry_is_refused_with_its_path_its_value_and_what_is_expected(entry, value, words):
    document = {**RIGHT, entry: value}
    if value is ...:
        del document[entry]
    with pytest.raises(UnreadableFile) as error:
        EXAMPLE.checked(document, Path("a.json"))
    assert str(error.value) == f"a.json: {words}"
    beyond_schema = entry == "rows" or value == {
        "side": 3.0
    }  # it cannot compare lengths, and 3.0 is whole to it
    assert jsonschema.Draft202012Validator(EXAMPLE.schema()).is_valid(document) == beyond_schema


def test_other_entries_are_kept_where_the_declaration_is_open():
    open_one = Document("example", "an example", Example, marks=(Open(),))
    assert open_one.checked({**RIGHT, "more": 1}, Path("a.json"))["more"] == 1
    assert open_one.schema()["additionalProperties"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "it is empty"),
        (b"\xff\xfe{", "'utf-8' codec can't decode byte 0xff"),
        (b'{"a": 1', "Expecting ',' delimiter"),
        (b'{"a": 1, "a": 2}', "the key 'a' is there twice"),
        (b'{"a": NaN}', "a number is not finite, or too large"),
        (b'{"a": [-Infinity]}', "a number is not finite, or too large"),
        (b'{"a": 1e999}', "a number is not finite, or too large"),
        (b'{"a": 1' + b"0" * 400 + b"}", "a number is not finite, or too large"),
        (b'{"a": ' + b"9" * 5000 + b"}", "a number is not finite, or too large"),
        (b'{"a": "\\ud800"}', r"the text '\ud800' holds NUL or half a character"),
        (b'{"a\\u0000": 1}', r"the text 'a\x00' holds NUL or half a character"),
        (b"[" * 100_000, "more than 64 levels lie inside each other"),
        (b'{"a":' + b"[" * 64 + b"]" * 64 + b"}", "more than 64 levels lie inside each other"),
        (b"[1]", "it is [1]; expected an object"),
    ],
)
def test_what_is_no_json_object_is_refused_with_the_reason(content, words, tmp_path):
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(UnreadableFile) as error:
        read_json_object(tmp_path / "a.json")
    assert words in str(error.value) and "a.json" in str(error.value) and "\n" not in str(error.value)


def test_a_byte_order_mark_and_characters_beyond_16_bits_are_read(tmp_path):
    (tmp_path / "a.json").write_bytes(b'\xef\xbb\xbf{"a": "\\ud83d\\ude00"}')
    assert read_json_object(tmp_path / "a.json") == {"a": "\U0001f600"}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.name)
def test_the_schema_in_data_spec_is_made_from_the_declaration(document):
    jsonschema.Draft202012Validator.check_schema(document.schema())
    text = (ROOT / "data_spec" / f"{document.name}.schema.json").read_text(encoding="utf-8")
    assert text == schema_text(document), (
        "make it again: python -m morphspace.cli.documents schemas data_spec"
    )
    assert json.loads(text) == document.schema()


# Any document of a declaration, and the same with a part replaced.

TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")), max_size=6)
ANY_LETTER = re.compile(r"\[\^/\]|\\S|(?<!\\)\.")  # in patterns; Hypothesis is slow with all of Unicode
NUMBERS = st.floats(-1e9, 1e9).filter(lambda number: not number.is_integer()) | st.integers(-9, 10**6)
JSON = st.recursive(
    st.none() | st.booleans() | NUMBERS | TEXTS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=4,
)


def values_of(kind: Any, marks: tuple[Any, ...] = ()) -> st.SearchStrategy[Any]:
    """Return the strategy of all values that a declaration describes."""
    kind, marks = kind_and_marks(kind, marks)
    inner, length = typing.get_args(kind), mark_of(marks, Len) or Len(0)
    if is_union(kind):
        return st.one_of([values_of(member, marks) for member in inner])
    if typing.is_typeddict(kind):
        entries = {key: values_of(field.kind, field.marks) for key, field in entries_of(kind).items()}
        required = {key: entries.pop(key) for key, field in entries_of(kind).items() if field.required}
        return st.fixed_dictionaries(required, optional=entries)
    if typing.get_origin(kind) is dict:
        held = mark_of(marks, Holds) or Holds(())
        more = st.dictionaries(
            values_of(inner[0]), values_of(inner[1]), min_size=length.min_length, max_size=3
        )
        always = st.fixed_dictionaries({key: values_of(inner[1]) for key in held.names})
        return st.tuples(more, always).map(lambda both: {**both[0], **both[1]})
    if typing.get_origin(kind) is list:
        rows = st.lists(st.lists(NUMBERS, min_size=2, max_size=2), min_size=1, max_size=2)
        most = length.max_length or length.min_length + 2
        lists = st.lists(values_of(inner[0]), min_size=length.min_length, max_size=most)
        return rows if mark_of(marks, OneLength) else lists
    if typing.get_origin(kind) is Literal or mark_of(marks, OneOf):
        return st.sampled_from(inner or mark_of(marks, OneOf).values)
    if kind in (int, float):
        low, above, high = (mark_of(marks, limit) for limit in (Ge, Gt, Le))
        least = low.ge if low else above.gt if above else -100
        most = high.le if high else least + 10**6
        if kind is int:
            return st.integers(least + (above is not None), most)
        return st.floats(least, most, exclude_min=above is not None).filter(lambda one: not one.is_integer())
    if kind is str:
        pattern = mark_of(marks, Pattern)
        return (
            TEXTS
            if pattern is None
            else st.from_regex(ANY_LETTER.sub("[a-z]", pattern.regex), fullmatch=True)
        )
    return {Any: JSON, bool: st.booleans(), type(None): st.none()}[kind]


def places_in(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """List the paths of all parts of a JSON value."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(place for key, one in parts for place in places_in(one, (*path, key)))]


def replaced(value: Any, path: tuple[Any, ...], part: Any) -> Any:
    """Return a JSON value with the part at a path replaced."""
    if not path:
        return part
    copy = value.copy()
    copy[path[0]] = replaced(value[path[0]], path[1:], part)
    return copy


@st.composite
def damaged(draw: st.DrawFn, document: Document[Any]) -> Any:
    """Draw a document of a declaration with one part replaced by any JSON value."""
    right = draw(values_of(document.shape))
    return replaced(right, draw(st.sampled_from(places_in(right))), draw(JSON))


@cache
def validator_of(document: Document[Any]) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(document.schema())


KINDS = pytest.mark.parametrize("document", [EXAMPLE, *DOCUMENTS], ids=lambda document: document.name)


@KINDS
@settings(max_examples=6, deadline=None, derandomize=True)
@given(data=st.data())
def test_every_document_that_a_declaration_describes_is_taken(document, data):
    right = data.draw(values_of(document.shape))
    assert document.checked(right, Path("a.json")) is right
    validator_of(document).validate(right)


@KINDS
@settings(max_examples=20, deadline=None, derandomize=True)
@given(data=st.data())
def test_schema_and_check_take_and_refuse_the_same_documents(document, data):
    changed = data.draw(damaged(document))
    is_valid = validator_of(document).is_valid(changed)
    try:
        document.checked(changed, Path("a.json"))
    except UnreadableFile as error:
        assert not is_valid or " as in the first row" in str(error)
        assert str(error).startswith("a.json: ") and "; expected " in str(error) and "\n" not in str(error)
    else:
        assert is_valid


@KINDS
@settings(max_examples=20, deadline=None, derandomize=True)
@given(content=st.binary(max_size=60) | JSON.map(lambda value: json.dumps(value).encode()))
def test_nothing_but_an_unreadable_file_leaves_a_reader(document, content, tmp_path_factory):
    path = tmp_path_factory.mktemp("any") / "a.json"
    path.write_bytes(content)
    try:
        read = document.read(path)
    except UnreadableFile as error:
        assert "a.json" in str(error) and "\n" not in str(error)
    else:
        assert read == json.loads(content)


# Every reader of a file with a document.


@pytest.fixture(scope="module")
def files(model, tmp_path_factory):
    """A folder with a file of each reader, and for each its reader and the path of its document."""
    folder = tmp_path_factory.mktemp("files")
    points = np.array([[10.25, 20.0], [30.0, 20.5], [20.0, 35.0]])
    marked = MarkedFaceframe("frame_0001", points)
    write_sidecar(
        folder / "clip.json", Sidecar("actor-07", 25.0, "research", "CC BY 4.0", marked, {"of": "me"})
    )
    head = {"format": "morphspace-faceframe", "version": 1, "image": "a.png", "size": [40, 50]}
    entries = dict(zip(POINT_NAMES, points.tolist(), strict=True))
    (folder / "points.json").write_text(json_text({**head, **entries}))
    told = {"model_id": "0f3a", "identity": "ann", "frame_rate_hz": 25.0}
    write_loadings_table(folder / "table.csv", np.ones((2, 3)), ["a", "b"], told)
    model.save(folder / "a.morph")
    result_of(sample.run(SampleRequest(folder / "a.morph", folder / "set", count=1)))
    return folder


def replay(path: Path) -> object:
    return result_of(replayed(path, path.parent / "a.morph"))


READERS = {
    "clip.json": read_sidecar,
    "points.json": read_faceframe,
    "table.json": lambda path: read_loadings_table(path.with_suffix(".csv")),
    "set/sample_0000.json": replay,
    "set/record.json": RECORD.read,
}


@pytest.mark.parametrize("name", READERS)
@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_a_reader_takes_a_damaged_document_or_refuses_it_in_one_line(name, data, files):
    whole = json.loads((files / name).read_text(encoding="utf-8"))
    changed = replaced(whole, data.draw(st.sampled_from(places_in(whole))), data.draw(JSON))
    text = json.dumps(changed).encode()
    content = data.draw(st.just(text) | st.binary(max_size=60) | st.just(text[: len(text) // 2]))
    path = files / Path(name).name
    path.write_bytes(content)
    try:
        READERS[name](path)
    except BadInput as error:
        assert "\n" not in str(error)
    finally:
        (files / name).write_text(json_text(whole), encoding="utf-8")


@settings(max_examples=40, deadline=None, derandomize=True)
@given(data=st.data())
def test_a_model_with_a_damaged_document_is_refused_or_opened(data, files):
    arrays, whole = read_container(files / "a.morph")
    changed = replaced(whole, data.draw(st.sampled_from(places_in(whole))), data.draw(JSON))
    write_container(files / "damaged.morph", arrays, changed if isinstance(changed, dict) else {"a": changed})
    try:
        found = load_model(files / "damaged.morph")
    except ModelFileError as error:
        assert "damaged.morph" in str(error) and "\n" not in str(error)
    else:
        assert found.identity == changed["provenance"]["identity"]
        framing_of(found), landmarks_of(found), lip_of(found)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(text=st.text(max_size=20) | JSON.map(json.dumps))
def test_any_text_inside_a_stimulus_is_read_or_ignored(text, tmp_path_factory):
    path = tmp_path_factory.mktemp("stimulus") / "a.png"
    path.write_bytes(png_with_texts(np.zeros((2, 2, 3), np.uint8), {KEYWORD: text}))
    found = essentials_in(path)
    assert found is None or "request_sha256" in found
