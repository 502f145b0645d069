"""Results: whole or not at all, and where they cannot be written it is told."""

import errno
import os

import pytest

from hpac_gym.output import (
    OutputError,
    replacing,
    writable_file,
    writable_folder,
    writable_results,
    write_text,
)

FULL = r"cannot write '.*result\.txt': No space left on device"


@pytest.mark.parametrize(
    ("fault", "told", "line"),
    [
        (KeyboardInterrupt(), KeyboardInterrupt, None),
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), OutputError, FULL),
    ],
)
def test_a_file_appears_whole_or_not_at_all(fault, told, line, tmp_path):
    path = tmp_path / "result.txt"
    write_text(path, "before")

    def interrupted() -> None:
        with replacing(path) as temporary:
            temporary.write_text("half of")
            raise fault

    with pytest.raises(told, match=line):
        interrupted()
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_and_its_file_is_written(tmp_path):
    link = tmp_path / "link.txt"
    link.symlink_to("results/file.txt")
    write_text(link, "text")
    assert link.is_symlink()
    assert (tmp_path / "results" / "file.txt").read_text() == "text"


def test_a_device_is_not_replaced_by_a_file(tmp_path):
    os.mkfifo(tmp_path / "null")
    for write in (writable_file, lambda path: write_text(path, "text")):
        with pytest.raises(OutputError, match=r"cannot write '.*null': it is a device"):
            write(tmp_path / "null")
    assert (tmp_path / "null").is_fifo()


def test_only_results_and_empty_files_are_replaced_by_results(tmp_path):
    path = tmp_path / "results.json"
    writable_results(path, "a")
    for text in ("", '{"a": 1, "b": 2}', '[{"a": 1}]'):
        path.write_text(text)
        writable_results(path, "a")
    for text in ("[1]", "[]", '{"b": {"a": 1}}', "name = 1", "0", "[" * 100_000):
        path.write_text(text)
        with pytest.raises(OutputError, match=r"results\.json' exists and has no results: name"):
            writable_results(path, "a")
    assert list(tmp_path.iterdir()) == [path]


def test_a_name_that_is_too_long_is_told_before_a_long_run(tmp_path):
    for letters in (250, 300):  # the temporary file has a longer name
        with pytest.raises(OutputError, match=r"cannot write '.*xx': File name too long"):
            writable_file(tmp_path / ("x" * letters))
    assert not [*tmp_path.iterdir()]


def test_a_folder_is_made_and_left_empty_and_what_cannot_be_written_is_told(tmp_path):
    assert list(writable_folder(tmp_path / "a" / "b").iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"cannot write to folder .*file/b"):
        writable_folder(tmp_path / "file" / "b")
    with pytest.raises(OutputError, match=r"cannot write .*file/result\.txt"):
        write_text(tmp_path / "file" / "result.txt", "text")
