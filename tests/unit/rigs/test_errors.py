import pytest

from rigs.errors import RigError, Spike4dgsError


def test_an_error_prints_its_fields_in_one_line():
    assert str(RigError("found 2", "3", "add one", where="lab.toml")) == "lab.toml: found 2, expected 3; add one"
    assert str(RigError("found 2")) == "found 2"


def test_places_are_put_before_one_another_and_fields_are_kept():
    with pytest.raises(RigError) as caught, RigError.located("lab.toml"), RigError.located("cam01"):
        raise RigError("found 2", "3", "add one")
    error = caught.value
    assert (error.where, error.found, error.expected, error.do) == ("lab.toml: cam01", "found 2", "3", "add one")


def test_errors_of_another_class_are_left_alone():
    with pytest.raises(Spike4dgsError) as caught, RigError.located("lab.toml"):
        raise Spike4dgsError("found 2")
    assert caught.value.where == ""


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    path = tmp_path / "none.toml"
    with pytest.raises(RigError) as caught, RigError.reading(path, "give another"):
        path.read_bytes()
    assert str(caught.value) == f"{path}: cannot be read (No such file or directory); give another"
