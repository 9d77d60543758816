"""TensorBoard's files on a disk that is full."""

import errno
import os
import threading

import pytest
from tensorboard.compat.tensorflow_stub.io.gfile import LocalFileSystem

from vergence.training.logs import TensorBoardWriter


def write_many(writer):
    for step in range(10_000):
        writer.write({"loss": 1.0}, {"loss": ()}, step)


def test_a_full_disk_is_said_by_the_writer_and_by_no_thread(tmp_path, monkeypatch, capsys):
    before = threading.excepthook
    writer = TensorBoardWriter(tmp_path, None)

    def full(*_words):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(LocalFileSystem, "_write", full)
    with pytest.raises(OSError, match="No space left"):
        write_many(writer)
    with pytest.raises(OSError, match="No space left"):
        writer.close()
    assert threading.excepthook is before
    assert capsys.readouterr().err == ""
