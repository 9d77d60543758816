"""`vergence view`: what it refuses before a page is served, and how it ends."""

import signal
import subprocess
import sys
import urllib.request

import pytest

from tests.commands.called import call, refused
from tests.naming import named

pytest.importorskip("viser")


def test_what_cannot_be_shown_is_refused_in_one_line(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for words, said in (
        (["--port", "70000"], "port: expected 0 to 65535, got 70000"),
        (["--head", "nobody"], "head"), (["--controller", "nobody"], "controller"),
        (["nowhere.mcap"], "nowhere.mcap"), (["."], "it has no trajectory.csv"),
        (["--host", "nowhere.invalid", "--port", "0"], "host"),
    ):  # fmt: skip
        with named(words):
            assert said in refused(capsys, "view", "--no-browser", *words)


def test_without_its_extra_it_says_what_to_install(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "pip install 'vergence[view]'" in refused(capsys, "view")


@pytest.mark.nightly
def test_the_page_is_served_until_ctrl_c(tmp_path):
    command = [sys.executable, "-m", "vergence", "view", "--no-browser", "--port", "0"]
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # ignored in background
    )  # fmt: skip
    try:
        line = process.stderr.readline()
        url = next(word for word in line.split() if word.startswith("http://127.0.0.1:"))
        with urllib.request.urlopen(url) as page:
            assert b"<html" in page.read()
        process.send_signal(signal.SIGINT)
        _out, err = process.communicate(timeout=60)
        assert process.returncode == 0
        assert [said for said in err.splitlines() if "compiling kernels" not in said] == []
    finally:
        process.kill()
        process.communicate()


def test_a_log_is_followed_and_the_page_opened(capsys, monkeypatch, tmp_path):
    pytest.importorskip("mcap")
    opened, followed = [], []

    def run(view):
        followed.append(view.words)
        raise KeyboardInterrupt

    monkeypatch.setattr("vergence.viewer.live.LiveView.run", run)
    monkeypatch.setattr("vergence.commands.view._yield_processors", lambda: None)
    monkeypatch.setattr("webbrowser.open", opened.append)
    assert call("view", "--follow", tmp_path, "--port", 0) == 0
    assert "waiting for a log" in followed[0]
    assert f"showing on {opened[0]} until Ctrl-C" in capsys.readouterr().err
