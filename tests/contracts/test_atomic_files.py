"""Files appear whole or not at all, and pipes stay pipes."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading

import numpy as np
import pytest

from wrt.atomic_files import new_folder, replaced


def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path):
    """Also Ctrl-C, and an error after the file was closed by whoever wrote it."""
    path = tmp_path / "old.bin"
    path.write_bytes(b"old")
    for error in (KeyboardInterrupt, ValueError, MemoryError):
        with pytest.raises(error), replaced(path) as file:
            _half_written(file, error)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["old.bin"]


def _half_written(file, error):
    file.write(b"new")
    file.close()
    raise error


def _half_made(folder, error):
    folder.mkdir()
    with open(folder / "metadata.yaml", "wb") as file:
        _half_written(file, error)


def test_errors_name_the_file_of_the_caller(tmp_path, monkeypatch):
    """Not the temporary one, and also where NumPy and Pillow say nothing of a disk."""
    path = tmp_path / "folder" / "new.bin"
    with pytest.raises(FileNotFoundError, match=r"'\S*/folder/new\.bin'$"), replaced(path):
        pass
    path = tmp_path / "new.bin"
    with pytest.raises(OSError, match=r"No space left on device: '\S*/new\.bin'$"), replaced(path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with (
        pytest.raises(OSError, match=r"new\.bin' cannot be written \(8 requested and 2 written\); is the disk full"),
        replaced(path),
    ):
        raise OSError("8 requested and 2 written")

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path.write_bytes(b"old")
    monkeypatch.setattr(os, "fsync", full)  # where file systems that write late say it
    with pytest.raises(OSError, match=r"No space left on device: '\S*/new\.bin'$"), replaced(path) as file:
        file.write(b"new")
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["new.bin"]


def test_older_contents_are_replaced_when_the_new_ones_are_on_the_disk(tmp_path, monkeypatch):
    """A file that replaces none is not waited for."""
    calls, fsync, replace = [], os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda descriptor: (calls.append("fsync"), fsync(descriptor)))
    monkeypatch.setattr(os, "replace", lambda *paths: (calls.append("replace"), replace(*paths)))
    for contents in (b"1", b"2"):
        with replaced(tmp_path / "file") as file:
            file.write(contents)
    assert calls == ["replace", "fsync", "replace"]
    assert (tmp_path / "file").read_bytes() == b"2"


def test_links_stay_and_permissions_are_kept(tmp_path):
    """A link to nothing makes the file it names, as opening it does. A file of others' hands is written, not the link."""
    target, link = tmp_path / "target", tmp_path / "link"
    link.symlink_to("target")
    for contents in (b"1", b"2"):
        with replaced(link) as file:
            file.write(contents)
        assert link.is_symlink()
        assert target.read_bytes() == contents
        target.chmod(0o640)
    assert target.stat().st_mode & 0o777 == 0o640
    link.unlink()
    link.symlink_to("link")
    with pytest.raises(OSError, match="link"), replaced(link):
        pass


def test_a_file_that_may_not_be_written_is_not_replaced(tmp_path, monkeypatch):
    """To replace it, the permission to write to its folder is enough."""
    path = tmp_path / "kept"
    path.write_bytes(b"old")
    path.chmod(0o444)
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # what others than root are told
    with pytest.raises(PermissionError, match="kept"), replaced(path) as file:
        file.write(b"new")
    assert path.read_bytes() == b"old"


@pytest.mark.parametrize("name", ["x" * 255, "ü" * 127], ids=["letters", "umlauts"])
def test_longest_names(tmp_path, name):
    for contents in (b"1", b"2"):
        with replaced(tmp_path / name) as file:
            file.write(contents)
    assert os.listdir(tmp_path) == [name]
    with pytest.raises(OSError, match="File name too long"), replaced(tmp_path / (name + "xx")):
        pass


def test_pipes_are_written_through_where_that_is_wanted(tmp_path):
    """After an error, nothing was written to them. Elsewhere they are refused, as folders always are."""
    pipe, read = tmp_path / "pipe", []
    os.mkfifo(pipe)
    for path in (pipe, os.devnull, "/dev/stdout", "/dev/fd/1", tmp_path):
        with pytest.raises(ValueError, match="not a regular file"), replaced(path):
            pass
    with pytest.raises(ValueError, match="not a regular file"), replaced(tmp_path, streams=True):
        pass
    with pytest.raises(KeyError), replaced(pipe, streams=True):  # opened, this would wait for a reader
        raise KeyError
    reader = threading.Thread(target=lambda: read.append(pipe.read_bytes()))
    reader.start()
    with replaced(pipe, streams=True) as file:
        np.savez(file, a=np.arange(3))  # an archive is not written from begin to end
    reader.join(20)
    assert read[0][:2] == b"PK"
    assert pipe.is_fifo()


def test_standard_output_is_not_replaced(tmp_path):
    """/dev/stdout leads to a file if standard output is one; replacing it would lose all that is printed before and after."""
    code = (
        "from wrt.atomic_files import replaced\nprint('before')\n"
        "with replaced('/dev/stdout', streams=True) as file: file.write(b'contents\\n')\nprint('after')"
    )
    with open(tmp_path / "out.txt", "wb") as out:
        subprocess.run([sys.executable, "-c", code], stdout=out, check=True)
        subprocess.run([sys.executable, "-c", "print('next')"], stdout=out, check=True)
    assert (tmp_path / "out.txt").read_text().split() == ["before", "contents", "after", "next"]
    assert os.listdir(tmp_path) == ["out.txt"]


def test_folders_appear_whole_or_not_at_all(tmp_path):
    for error in (KeyboardInterrupt, OSError):
        with pytest.raises(error), new_folder(tmp_path / "bag") as folder:
            _half_made(folder, error)
    assert not os.listdir(tmp_path)
    with new_folder(tmp_path / "bag") as folder:
        assert folder.name == "bag"
        folder.mkdir()
        (folder / "metadata.yaml").write_text("whole")
    assert (tmp_path / "bag" / "metadata.yaml").read_text() == "whole"
    with pytest.raises(FileExistsError, match="bag"), new_folder(tmp_path / "bag"):
        pass
    assert os.listdir(tmp_path) == ["bag"]
