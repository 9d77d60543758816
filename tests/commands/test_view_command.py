"""`vergence view`: what it refuses before a page is served, and how it ends."""

import signal
import subprocess
import sys
import urllib.request

import pytest

from vergence.cli import main

pytest.importorskip("viser")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--port", "70000"], "port: expected 0 to 65535, got 70000"),
        (["--head", "nobody"], "head"),
        (["--controller", "nobody"], "controller"),
        (["nowhere.mcap"], "nowhere.mcap"),
        (["."], "it has no trajectory.csv"),
        (["--host", "nowhere.invalid", "--port", "0"], "host"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(words, said, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stopped:
        main(["view", "--no-browser", *words])
    out, err = capsys.readouterr()
    assert stopped.value.code == 2
    assert out == ""
    assert err.startswith("vergence: error: ")
    assert said in err
    assert len(err.splitlines()) == 1


def test_without_its_extra_it_says_what_to_install(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(SystemExit):
        main(["view"])
    assert "pip install 'vergence[view]'" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("words", [[], ["--follow", "."]])
def test_the_page_is_served_until_ctrl_c(words, tmp_path):
    command = [sys.executable, "-m", "vergence", "view", "--no-browser", "--port", "0", *words]
    process = subprocess.Popen(
        command,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # ignored in background
    )
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
