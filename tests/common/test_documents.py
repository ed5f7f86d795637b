"""Documents are read strictly: anything but a plain, finite, shallow document of the schema is refused in one line."""

import dataclasses
import json
import os
import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzyarm.common.documents import _DEEPEST, DocumentError, check_schema, parse_json, read_json, read_toml, record

LEAVES = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
CONTENTS = st.recursive(LEAVES, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=20)


@dataclasses.dataclass(frozen=True)
class Link:
    mass: float
    names: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Robot:
    link: Link
    joints: int = 2
    payload: float | None = None

    def __post_init__(self):
        if self.joints < 1:
            raise ValueError("joints = 0 is out of range")


@settings(max_examples=20)
@given(CONTENTS)
def test_what_json_writes_is_read_back(content):
    assert parse_json(json.dumps(content)) == content == parse_json(json.dumps(content).encode())
    deepest = "[" * _DEEPEST + "]" * _DEEPEST
    assert json.dumps(parse_json(deepest)) == deepest


@given(st.binary(max_size=60) | st.text(max_size=60))
def test_whatever_it_is_given_it_raises_nothing_but_value_error(text):
    problem = ""
    try:
        parse_json(text)
    except ValueError as error:
        problem = str(error)
    assert problem == "" or (problem.startswith("the content cannot be read as JSON: ") and "\n" not in problem)


@pytest.mark.parametrize(
    ("read", "text", "problem"),
    [
        (read_json, b"", "Expecting value"),
        (read_json, b'{"a": 1, "b": {"c": 1, "c": 2}}', "the key 'c' occurs twice"),
        (read_json, b'{"gain": NaN}', "NaN is not a JSON number"),
        (read_json, b"[-Infinity]", "-Infinity is not a JSON number"),
        (read_json, b'{"gain": 1e999}', "'gain' is not finite"),
        (read_json, b"[1e999]", "a number is not finite"),
        (read_json, b"[" * (_DEEPEST + 1) + b"]" * (_DEEPEST + 1), f"more deeply than the allowed {_DEEPEST} levels"),
        (read_json, b"[" * 100_000 + b"]" * 100_000, "nested"),
        (read_json, b"1" * 5000, "digits"),
        (read_toml, b"mass = ", "cannot be read as TOML: "),
        (read_toml, b"a = 1\na = 2", "cannot be read as TOML: "),
        (read_toml, b'name = "\xff"', "cannot be read as TOML: "),
        (read_toml, b"x = " + b"[" * 9**5, "cannot be read as TOML: "),
        # Python would take a time that grows with the square of the parts.
        (read_toml, b".".join([b"a"] * (_DEEPEST + 2)) + b" = 1", f"a dotted key has more than the allowed {_DEEPEST}"),
        (read_toml, b".".join([b"a"] * 9**5) + b" = 1", "cannot be read as TOML: "),
    ],
)
def test_bad_documents_say_what_is_wrong(tmp_path, read, text, problem):
    path = tmp_path / "file"
    path.write_bytes(text)
    with pytest.raises(DocumentError, match=problem) as caught:
        read(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
    assert isinstance(caught.value, ValueError) and not isinstance(caught.value, tomllib.TOMLDecodeError)


@pytest.mark.parametrize("read", [read_json, read_toml])
def test_only_regular_files_of_a_limited_size_are_read(read, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DocumentError, match="not a regular file"):  # and it does not wait for a writer
        read(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "nothing"):
        with pytest.raises(OSError):
            read(path)
    path = tmp_path / "file"
    path.write_text("{}" if read is read_json else "# ")
    assert read(path, largest=2) == {}
    with pytest.raises(DocumentError, match="larger than the 1 bytes"):
        read(path, largest=1)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ({}, "link"),
        ({"link": {"mass": "3"}}, r"`link\.mass`"),
        ({"link": {"mass": True}}, r"`link\.mass`"),
        ({"link": {"mass": 1.0, "names": ["a", 1]}}, r"`link\.names\[1\]`"),
        ({"link": {"mass": 1.0}, "joints": 0}, "joints = 0 is out of range"),
        ({"link": {"mass": 1.0}, "color": "red"}, "unknown field color; known: joints, link, payload"),
        (None, "object"),
    ],
)
def test_what_does_not_fit_a_record_is_named_by_its_place(content, problem):
    fitting = {"link": {"mass": 3, "names": ["upper"]}, "payload": 1.5}
    assert record(fitting, Robot) == Robot(Link(3.0, ("upper",)), 2, 1.5)
    with pytest.raises(ValueError, match=problem):
        record(content, Robot)


@pytest.mark.parametrize("content", [None, "fuzzyarm/1", {}, {"schema": "fuzzyarm/2"}])
def test_another_schema_is_refused_with_both(content):
    assert check_schema({"schema": "fuzzyarm/1", "a": 1}, "fuzzyarm/1") == {"schema": "fuzzyarm/1", "a": 1}
    with pytest.raises(ValueError, match=r"the schema is .*; this version of fuzzyarm reads 'fuzzyarm/1'"):
        check_schema(content, "fuzzyarm/1")
