"""Several writers of one file, with a reader beside them: the reader sees whole files, and the last writer's stays."""

import threading

import numpy as np
import pytest

from maax_mjx.common.whole import UNFINISHED, whole


def test_writers_beside_each_other_and_a_reader(tmp_path):
    path = tmp_path / "a.npz"
    rows = np.arange(20_000)
    errors, reads, done = [], 0, threading.Event()

    def write(mine):
        try:
            for _ in range(40):
                with whole(path) as part:
                    np.savez(part, rows=rows, mine=mine)
        except OSError as error:
            errors.append(error)

    def read():
        nonlocal reads
        while not done.is_set() or not reads:
            try:
                with np.load(path) as file:
                    np.testing.assert_array_equal(file["rows"], rows)
                reads += 1
            except FileNotFoundError:
                if reads:
                    raise
            except Exception as error:
                errors.append(error)
                return

    reader = threading.Thread(target=read)
    writers = [threading.Thread(target=write, args=(i,)) for i in range(3)]
    for thread in (reader, *writers):
        thread.start()
    for thread in writers:
        thread.join()
    done.set()
    reader.join()
    assert not errors
    assert reads
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def test_a_file_that_was_not_finished_leaves_the_old_one(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def stop():
        with whole(path) as part:
            part.write_text("ne")
            assert part in UNFINISHED
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        stop()
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    assert not UNFINISHED


def test_places_where_no_file_can_be_written_are_named(tmp_path, monkeypatch):
    def write(path, *argument):
        with whole(path, *argument):
            raise AssertionError("it was let in")

    with pytest.raises(ValueError, match=r"path: got '.*', which is a folder; takes a file in a folder that can be"):
        write(tmp_path)
    with pytest.raises(ValueError, match=r"out: got '.*/none/a.txt', and no folder '.*/none' exists"):
        write(tmp_path / "none" / "a.txt", "out")
    monkeypatch.setattr("os.access", lambda path, mode: False)  # who runs the tests may write everywhere
    with pytest.raises(ValueError, match=r"path: got '.*a.txt', and the folder '.*' cannot be written"):
        write(tmp_path / "a.txt")
