import sys

import pytest

from acquisition.members import members


class Colour:
    def __init__(self, name):
        self.name = name


@pytest.fixture
def package(tmp_path, monkeypatch):
    folder = tmp_path / "palette"
    folder.mkdir()
    (folder / "__init__.py").write_text('"""Colours."""\n')
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    for name in [n for n in sys.modules if n.split(".")[0] == "palette"]:
        del sys.modules[name]


def write(folder, module, *names):
    lines = [f"C{i} = Colour({name!r})" for i, name in enumerate(names)]
    (folder / f"{module}.py").write_text("\n".join(["from test_colour_kind import Colour", *lines]))


@pytest.fixture(autouse=True)
def kind(monkeypatch):
    module = type(sys)("test_colour_kind")
    module.Colour = Colour
    monkeypatch.setitem(sys.modules, "test_colour_kind", module)


def test_a_new_file_is_a_new_member(package):
    write(package, "warm", "red", "orange")
    write(package, "cold", "blue")
    assert list(members("palette", Colour)) == ["blue", "red", "orange"]


def test_a_name_stands_once(package):
    write(package, "warm", "red")
    write(package, "warmer", "red")
    with pytest.raises(ValueError, match="'red' twice"):
        members("palette", Colour)
