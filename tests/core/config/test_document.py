import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.files.documents.yaml_document import Document, dump_yaml, load_yaml, parse_yaml


def value_of(text: str):
    return parse_yaml(f"key: {text}\n", "f.yaml").data["key"]


def refusal(text: str | bytes) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_yaml(text, "f.yaml")
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("f.yaml")
    return message


@pytest.mark.parametrize(
    ("text", "first", "second"),
    [
        ("a: 1\nb: 2\na: 3\n", 1, 3),
        ("top:\n  a: 1\n  b: 2\n  a: 1\n", 2, 4),
        ("top:\n  inner:\n    a: 1\n    a: 2\n", 3, 4),
        ("list:\n  - {x: 1}\n  - x: 1\n    y: 2\n    x: 3\n", 3, 5),
        ("list: [[{a: 1,\n a: 2}]]\n", 1, 2),
        ("a: 1\n'a': 2\n", 1, 2),
    ],
)
def test_a_duplicate_key_is_refused_at_any_depth_with_both_lines(text, first, second):
    key = "x" if "x: 3" in text else "a"
    assert refusal(text) == f"f.yaml:{second}: duplicate key '{key}', first at line {first}; remove one"


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        *(("1e-3", 0.001), ("1.568e-5", 1.568e-5), ("+1E6", 1e6), ("-2.5e+3", -2500.0), (".5", 0.5), ("-.5", -0.5)),
        *(("5.", 5.0), ("0.0", 0.0), (".inf", math.inf), ("-.Inf", -math.inf), (".nan", math.nan)),
        *(("10", 10), ("-7", -7), ("+7", 7), ("010", 10), ("08", 8), ("0", 0)),
        *(("true", True), ("False", False), ("~", None), ("null", None), ("", None), ("'1'", "1"), ('"true"', "true")),
    ],
)
def test_scalars_are_read_by_the_core_schema(text, wanted):
    assert repr(value_of(text)) == repr(wanted), "the type counts too"


@pytest.mark.parametrize(
    "text",
    [
        *("on", "off", "yes", "No", "y", "n", "ON"),
        *("12:30:45", "1:30", "-1:30", "190:20:30.15"),
        *("2026-01-31", "2026-01-31T10:00:00Z"),
        *("0x1F", "0b101", "0o17", "1_000", "1e", "e5", ".", "-", "=", "1.2.3", "inf", "nan", "tRue"),
    ],
)
def test_words_that_only_yaml_1_1_converts_stay_text(text):
    # A lone dash is a list's.
    assert value_of(text if text != "-" else "'-'") == text


@pytest.mark.parametrize("text", ["base: &b {x: 1}\nother: *b\n", "a: &a [*a]\n", "a: &a 1\nb: [2,\n *a]\n"])
def test_aliases_are_refused_with_their_line(text):
    message = refusal(text)
    assert "alias *" in message and "an error message could not name the line" in message
    assert message.startswith(f"f.yaml:{text[: text.index('*')].count(chr(10)) + 1}: ")


def test_a_bomb_of_nested_aliases_is_refused_at_once():
    bomb = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 40))
    assert refusal(bomb).startswith("f.yaml:2: ")


@pytest.mark.parametrize("text", ["\ta: 1\n", "a:\n\tb: 1\n", "a:\tb: c\n"])
def test_a_tab_is_named_with_its_line(text):
    assert refusal(text).startswith(
        f"f.yaml:{1 + text.startswith('a:' + chr(10))}: not valid YAML: found character '\\t'"
    )


@pytest.mark.parametrize(
    "text", ["", "\n\n", "# only a comment\n", "---\n", "- 1\n- 2\n", "[1, 2]\n", "text\n", "7\n", "~\n"]
)
def test_the_top_level_must_be_a_mapping(text):
    assert refusal(text) == "f.yaml: the top level must be a mapping of keys to values"


@pytest.mark.parametrize("text", ["1: a\n", "top:\n  true: a\n", "? [a, b]\n: c\n", "? {a: b}\n: c\n", "~: a\n"])
def test_a_key_must_be_text(text):
    assert refusal(text) == f"f.yaml:{1 + text.startswith('top')}: a key must be plain text"


@pytest.mark.parametrize(
    "text",
    [
        b"\x00\x01\x02\xff\xfe",
        b"\x89PNG\r\n\x1a\n\x00\x00",
        b"key: \xff\xfe\xfd",
        b"key: \x07",
        "key: 'open\n",
        "key: {a: 1\n",
        "key: [1, 2\n",
        "a: b: c\n",
        "a: 1\n---\nb: 2\n",
        "a: %x\n%",
        "key: " + "[" * 5000,
        "key: " + "9" * 5000,
    ],
)
def test_invalid_yaml_is_refused(text):
    assert "not valid YAML" in refusal(text)


@pytest.mark.parametrize(
    "tagged",
    [
        *("!!python/object/apply:os.system [ls]", "!!python/name:os.system", "!mine 1", "!!map [1]"),
        *("!!int x", "!!float x", "!!bool maybe", "!!timestamp x", "!!binary ü"),
    ],
)
def test_tags_that_run_code_or_do_not_fit_are_refused(tagged):
    assert "not valid YAML" in refusal(f"key: {tagged}\n")


@given(st.one_of(st.binary(max_size=60), st.text(max_size=60)))
def test_any_input_gives_a_mapping_or_a_config_error(text):
    try:
        assert isinstance(parse_yaml(text, "f").data, dict)
    except ConfigError as error:
        assert "\n" not in str(error)


def test_a_file_over_a_megabyte_is_refused_with_its_size(tmp_path):
    path = tmp_path / "big.yaml"
    path.write_bytes(b"a: 1\n" + b"#" * 1_000_000)
    with pytest.raises(ConfigError, match=r"big\.yaml: 1000005 bytes is too large"):
        load_yaml(path)
    path.write_bytes(b"a: 1\n" + b"#" * 999_995)
    assert load_yaml(path).data == {"a": 1}


def test_an_unreadable_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"gone\.yaml: cannot be read: No such file"):
        load_yaml(tmp_path / "gone.yaml")
    with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
        load_yaml(tmp_path)


def test_every_value_knows_its_line():
    document = parse_yaml("# comment\na: 1\nb:\n  c: [1,\n      2]\n  d: {e: x}\nf:\n", "f.yaml")
    lines = {("a",): 2, ("b", "c"): 4, ("b", "c", 1): 5, ("b", "d", "e"): 6, ("f",): 7}
    assert {path: document.place_of(path) for path in lines} == {path: f"f.yaml:{n}" for path, n in lines.items()}


def test_a_missing_key_has_the_line_of_the_mapping_around_it():
    document = parse_yaml("a: 1\nb:\n  c: {x: 1}\n", "f.yaml")
    assert document.place_of(("b", "c", "missing", 3)) == "f.yaml:3"
    assert Document({}, "f.yaml").place_of(("a",)) == "f.yaml"


def test_an_overridden_value_forgets_its_line_and_those_inside_it():
    document = parse_yaml("a:\n  b: {c: 1}\n  d: 2\n", "f.yaml")
    document.override_value(("a", "b"), {"c": 5}, "--b")
    document.override_value(("new", "inner"), 7, "--new")
    assert document.data == {"a": {"b": {"c": 5}, "d": 2}, "new": {"inner": 7}}
    assert document.place_of(("a", "b", "c")) == "--b"
    assert document.place_of(("a", "d")) == "f.yaml:3"


@pytest.mark.parametrize("value", ["5", "text", "", "true"])
def test_an_override_below_a_plain_value_leaves_it_to_be_named_when_checked(value):
    document = parse_yaml(f"a: {value}\n", "f.yaml")
    before = dict(document.data)
    document.override_value(("a", "b", "c"), 1, "--c")
    assert document.data == before
    assert document.place_of(("a",)) == "f.yaml:1"


def test_a_grafted_document_keeps_its_own_places():
    document = parse_yaml("rig: single\nseed: 1\n", "record.yaml")
    document.insert_document(("rig",), parse_yaml("# note\nname: x\n", "rig.yaml"))
    assert document.data == {"rig": {"name": "x"}, "seed": 1}
    assert document.place_of(("rig", "name")) == "rig.yaml:2"
    assert document.place_of(("seed",)) == "record.yaml:2"


scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(allow_nan=False),
    st.text(max_size=30),
    st.sampled_from(["1e-3", "08", "+.5", "on", "yes", "2026-01-01", "1:30", "0x1F", "null", "~", "a: b", "#x", "<<"]),
)
values = st.recursive(
    scalars,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=10), inner, max_size=4)),
    max_leaves=12,
)


@given(st.dictionaries(st.one_of(st.text(max_size=20), st.sampled_from(["1e5", "08", "on", ""])), values, max_size=5))
def test_dumped_data_reads_back_the_same(data):
    back = parse_yaml(dump_yaml(data), "f").data
    assert back == data
    assert repr(back) == repr(data), "types and the order of keys count too"
