import pytest

from twin.errors import FormatError
from twin.formats.toml_reading import StrictModel, key_path, read_toml


class Inner(StrictModel):
    size_mm: float
    span_mm: tuple[float, float] = (0.0, 1.0)


class Outer(StrictModel):
    name: str
    inner: dict[str, Inner]
    amounts: float | tuple[float, ...] = 1.0


GOOD = 'name = "a"\n[inner.one]\nsize_mm = 2.0\n'


def test_reads():
    value = read_toml(GOOD, "f.toml", Outer)
    assert value.inner["one"].size_mm == 2.0


@pytest.mark.parametrize(
    ("text", "key", "says"),
    [
        ('name = "a"\n[inner.one]\nsise_mm = 2.0', "inner.one.sise_mm", "Did you mean 'size_mm'"),
        ('name = "a"\n[inner.one]\nsize_mm = nan', "inner.one.size_mm", "finite"),
        ('name = "a"\n[inner.one]\nsize_mm = "x"', "inner.one.size_mm", "found 'x'"),
        ('name = "a"\n[inner.one]\nsize_mm = 1.0\nspan_mm = [0.0]', "inner.one.span_mm[1]", "value number 2"),
        ('name = "a"\n[inner.one]', "inner.one.size_mm", "is missing"),
        ('name = "a"\namounts = [1.0, "b"]\n[inner.one]\nsize_mm = 1', "amounts[1]", "found 'b'"),
        (GOOD + "wholly_different = 1", "inner.one.wholly_different", "Known keys here: size_mm, span_mm"),
    ],
)
def test_each_mistake_names_file_and_key(text, key, says):
    with pytest.raises(FormatError) as caught:
        read_toml(text, "f.toml", Outer)
    assert caught.value.where == {"file": "f.toml", "key": key}
    assert says in str(caught.value)


def test_all_wrong_keys_are_listed():
    with pytest.raises(FormatError, match=r"unknown key 'zeta'; also wrong in this file: inner, name"):
        read_toml("zeta = 1", "f.toml", Outer)


def test_no_toml_at_all():
    with pytest.raises(FormatError, match=r"not valid TOML.*line 1.*f\.toml"):
        read_toml("name = a b", "f.toml", Outer)


def test_key_path():
    assert key_path(("axes", "X", "range_mm", 0)) == "axes.X.range_mm[0]"
