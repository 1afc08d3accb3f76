"""Settings: what is taken, what is refused, and how both are said."""

from pathlib import Path
from typing import Annotated, Literal

import pytest
from annotated_types import Ge, Gt, Le

from morphspace.requests import Crop, Size, declared, request_from
from morphspace.settings import (
    Help,
    NamesFile,
    OneOf,
    Option,
    Separated,
    Spelled,
    WrongSetting,
    converted,
    field_of,
)

Pair = tuple[float, float]
Points = Annotated[tuple[Pair, Pair, Pair], Separated(" ", "78,101 124,100 101,140")]
AUTO = Annotated[float | None, Ge(0), Le(3), Spelled("auto")]


def read(kind, given):
    return converted(field_of("x", kind), given, lambda words: Path("/x") / words)


@pytest.mark.parametrize(
    ("kind", "given", "expected"),
    [
        (float, "0.5", 0.5),
        (int, 3.0, 3),
        (float | None, None, None),
        (tuple[float, ...], 0.5, (0.5,)),
        (tuple[float, ...], "0.5,1;-1", (0.5, 1.0, -1.0)),
        (tuple[str, ...], "a,b;c", ("a,b", "c")),
        (tuple[int, int], [3, 4], (3, 4)),
        (str | None, 5, "5"),
        (bool, "true", True),
        (Path | None, "a.csv", Path("/x/a.csv")),
        (Annotated[str, NamesFile()], "a.csv", "/x/a.csv"),
        (Size, "200x240", (200, 240)),
        (Crop | Literal["auto"] | None, "1,2,3,4", (1, 2, 3, 4)),
        (Crop | Literal["auto"] | None, "auto", "auto"),
        (Points, "1,2 3,4  5,6", ((1.0, 2.0), (3.0, 4.0), (5.0, 6.0))),
        (AUTO, "auto", None),
        (AUTO, "3", 3.0),
        (Literal[".mp4", ".mkv"], "mkv", ".mkv"),
        (Annotated[str, OneOf(("a", "b"))], "b", "b"),
        (float | Literal["auto"], "auto", "auto"),
        (float | Literal["auto"], "1e1", 10.0),
    ],
)
def test_a_value_becomes_the_kind_of_the_setting(kind, given, expected):
    found = read(kind, given)
    assert found == expected and type(found) is type(expected)
    assert converted(field_of("x", kind), found) == expected  # a request is made of a request's values


@pytest.mark.parametrize(
    ("kind", "given", "expected"),
    [
        (float, "x", "x is 'x'; expected a number"),
        (float, True, "x is True; expected a number"),
        (float, float("inf"), "x is inf; expected a number"),
        (float, "1_0", "x is '1_0'; expected a number"),
        (float, None, "x is None; expected a number"),
        (int, 1.5, "x is 1.5; expected a whole number"),
        (Annotated[int, Ge(1), Le(100_000)], 0, "x is 0; expected a whole number from 1 to 100,000"),
        (Annotated[int, Ge(1)], "0", "x is 0; expected a whole number from 1 up"),
        (Annotated[float, Gt(0), Le(2.5)], 0.0, "x is 0.0; expected a number above 0, up to 2.5"),
        (Annotated[float, Gt(0), Le(2.5)], "3", "x is 3; expected a number above 0, up to 2.5"),
        (AUTO, 4, "x is 4; expected a number from 0 to 3 or auto"),
        (str, ["a"], "x is ['a']; expected a text"),
        (str, "", "x is empty; expected a text"),
        (Path, "", "x is empty; expected a path"),
        (Path, 3, "x is 3; expected a path"),
        (bool, 1, "x is 1; expected true or false"),
        (tuple[int, int], [1, 2, 3], "x is 1, 2, 3; expected 2 whole numbers"),
        (tuple[int, int], ("a", "2"), "x is 'a', 2; expected 2 whole numbers"),
        (tuple[Literal["a", "b"], ...], ("c",), "x is 'c'; expected one or more of a, b"),
        (tuple[float, ...], "1,,2", "x is '1,,2'; expected a list of numbers"),
        (tuple[float, ...], [], "x is []; expected a list of numbers"),
        (tuple[float, ...], {"a": 1}, "x is {'a': 1}; expected a list of numbers"),
        (Size, "8", "x is 8; expected 2 whole numbers, such as 200x240"),
        (Points, "1,2", "x is '1,2'; expected 3 pairs of numbers, such as 78,101 124,100 101,140"),
        (Literal["a", "b"], "c", "x is 'c'; expected one of a, b"),
        (Annotated[str, OneOf(("a", "b"))], "c", "x is 'c'; expected one of a, b"),
        (
            Crop | Literal["auto"] | None,
            "around",
            "x is 'around'; expected 4 whole numbers, such as 10,20,200,240, or auto",
        ),
    ],
)
def test_a_value_of_another_kind_is_refused_with_what_was_expected(kind, given, expected):
    with pytest.raises(WrongSetting) as refused:
        read(kind, given)
    assert str(refused.value) == expected


@declared
class DrawRequest:
    """Draw."""

    model: Path
    output: Path
    gains: Annotated[tuple[float, ...] | None, Option("--gain"), Help("Gains.")] = (0.5, 1.0)
    region: str | None = "eyes"

    def check(self):
        if self.gains == (9.0,):
            raise WrongSetting("gains", "is 9 with a region; expected less")


def test_a_constructor_converts_and_refuses():
    request = DrawRequest("a.morph", "out", gains=[1, "2"])
    assert request == DrawRequest(Path("a.morph"), Path("out"), (1.0, 2.0))
    with pytest.raises(WrongSetting, match=r"gains is 'x'; expected a list of numbers"):
        DrawRequest("a.morph", "out", gains="x")
    with pytest.raises(WrongSetting, match="9 with a region"):
        DrawRequest("a.morph", "out", gains=9)
    with pytest.raises(AttributeError):
        request.gains = ()


def test_a_recipe_says_none_and_must_say_what_is_required():
    made = request_from(DrawRequest, {"model": "a", "region": "none", "gains": "none"}, output=Path("out"))
    assert made.region is None and made.gains is None
    assert DrawRequest("a", "out", region="none").region == "none"  # in Python it is a text
    with pytest.raises(WrongSetting, match="model is missing; expected a path"):
        request_from(DrawRequest, {}, output=Path("out"))


@pytest.mark.parametrize("written", ["1,5", "0.5,1", "1,5;2", " 1 , 5 "])
def test_a_comma_between_numbers_is_refused_in_a_recipe(written):
    given = {"model": "a", "gains": written}
    with pytest.raises(
        WrongSetting, match=r"gains is '.*'; expected decimal points, and semicolons between"
    ) as caught:
        request_from(DrawRequest, given, output=Path("out"))
    assert caught.value.name == "gains"
    assert request_from(DrawRequest, {"model": "a", "gains": "1.5;2"}, output=Path("out")).gains == (1.5, 2.0)


@pytest.mark.parametrize("given", ["M\udcfcller", Path("M\udcfcller"), ["a", "M\udcfcller"]])
def test_a_name_that_is_not_utf8_is_refused_in_one_printable_line(given):
    for name, kind in (("model", Path), ("clip", tuple[str, ...])):
        field = field_of(name, kind)
        with pytest.raises(
            WrongSetting, match=rf"{name} is .*udcfcller.*; expected UTF-8. Rename the file"
        ) as caught:
            converted(field, given)
        assert str(caught.value).isprintable()


def test_texts_are_composed_but_not_the_names_of_files():
    assert converted(field_of("frame", str), "a\u0301") == "\u00e1"
    assert converted(field_of("model", Path), "a\u0301") == Path("a\u0301")
