"""Several files appear in a folder together, or not at all."""

import re
from pathlib import Path

import pytest

from omnisyn_cli.errors import OutputPathError, WriteError
from omnisyn_cli.io.outputs import check_staged_folder, former_files, replaced_folder, staged_folder, write_errors


def write_two(folder: Path, error: type[BaseException] | None = None) -> None:
    with staged_folder(folder) as staged:
        for name in ("a", "b"):
            (staged / name).write_text(name)
        assert not [file for file in folder.glob("*") if not file.name.startswith(".")]
        if error:
            raise error


@pytest.mark.parametrize("exists", [True, False])
def test_files_appear_at_the_end(tmp_path, exists):
    folder = tmp_path / "depth"
    if exists:
        folder.mkdir()
    write_two(folder)
    assert {file.name: file.read_text() for file in folder.iterdir()} == {"a": "a", "b": "b"}
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.parametrize("exists", [True, False])
@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_after_a_failure_nothing_is_there(tmp_path, exists, error):
    folder = tmp_path / "depth"
    if exists:
        folder.mkdir()
    with pytest.raises(error):
        write_two(folder, error)
    assert list(tmp_path.iterdir()) == ([folder] if exists else [])
    assert not exists or not list(folder.iterdir())


def test_what_a_former_output_has_beyond_the_new_one_goes_and_nothing_else(tmp_path):
    """What its document names and is called like its files; strangers stay, whatever they are called."""
    own_file = re.compile(r"(?:parts|more)/\d+")
    for names in (["parts/0", "parts/1", "more/2"], ["parts/0"]):
        former = former_files(tmp_path, ["list", "else"], own_file)
        with replaced_folder(tmp_path, former, overwrite=True) as staged:
            for name in names:
                (staged / name).parent.mkdir(exist_ok=True)
                (staged / name).write_text(name)
            (staged / "list").write_text(" ".join([*names, "/etc/hosts", "notes"]))
        for name in ("parts/7", "notes", "else"):
            (tmp_path / name).write_text("mine")
    files = {file.relative_to(tmp_path).as_posix() for file in tmp_path.rglob("*")}
    assert files == {"parts", "parts/0", "list", "parts/7", "notes", "else"}


def test_folders_in_it_are_made_or_added_to(tmp_path):
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "mine").write_text("mine")
    for text in ("first", "second"):
        with staged_folder(tmp_path) as staged:
            for folder in ("old", "new"):
                (staged / folder / "deep").mkdir(parents=True)
                (staged / folder / "deep" / "a").write_text(text)
    files = {str(file.relative_to(tmp_path)): file.read_text() for file in tmp_path.rglob("*") if file.is_file()}
    assert files == {"old/mine": "mine", "old/deep/a": "second", "new/deep/a": "second"}

    def write_again() -> None:
        with staged_folder(tmp_path, overwrite=False) as staged:
            (staged / "new" / "deep").mkdir(parents=True)
            (staged / "new" / "deep" / "a").write_text("third")

    with pytest.raises(OutputPathError, match=r"deep/a: expected a new file"):
        write_again()
    assert (tmp_path / "new" / "deep" / "a").read_text() == "second"


def test_a_folder_that_cannot_be_filled_is_refused(tmp_path):
    (tmp_path / "file").touch()
    check_staged_folder(tmp_path / "new")
    with pytest.raises(OutputPathError, match="create it first"):
        check_staged_folder(tmp_path / "no" / "new")
    with pytest.raises(OutputPathError, match="got a file"):
        check_staged_folder(tmp_path / "file")


def test_what_appeared_in_the_meantime_is_kept(tmp_path):
    def write(name: str, theirs: str) -> None:
        with staged_folder(tmp_path, overwrite=False) as staged:
            for new in ("a", name):
                (staged / new).write_text(new)
            (tmp_path / name).write_text(theirs)

    with pytest.raises(OutputPathError, match="b: expected a new file"):
        write("b", "mine")
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("b", "mine")]


@pytest.mark.parametrize("exists", [True, False])
def test_errors_name_files_as_they_would_be_called(tmp_path, exists):
    folder = tmp_path / "depth"
    if exists:
        folder.mkdir()
    with pytest.raises(WriteError) as caught, staged_folder(folder) as staged, write_errors(staged / "a"):
        raise OSError(28, "No space left on device")
    assert str(caught.value).startswith(f"{folder / 'a'}: expected to write it")
