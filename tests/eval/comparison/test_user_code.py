"""Controllers of somebody's own: found where they are, and their mistakes said in one line."""

import json
import os
import sys
from textwrap import dedent

import numpy as np
import pytest

from tests.naming import named
from vergence.cli import main
from vergence.errors import ConfigurationError, HardwareError, UserControllerError, VergenceError
from vergence.eval.comparison.contestants import GuardedController, make_contestants
from vergence.eval.comparison.evaluate import EvaluateConfig, evaluate
from vergence.reporting.jobs import ProcessMapper

GENTLE = """
import vergence
{first}

class Gentle:
    def __init__(self, head, layout, gain=3.0):
        self.law = vergence.make_controller("ibvs", head=head, layout=layout, gain=gain)
        self.calls = 0
        {making}

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.calls += 1
        {acting}
        return self.law.predict(observation, state, episode_start)
"""


@pytest.fixture(autouse=True)
def clean(monkeypatch, tmp_path, undrawn):
    """A current folder of its own, and no trace of it in the interpreter."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path not in ("", os.getcwd())])
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if getattr(sys.modules[name], "__file__", None) and "mine" in name:
            del sys.modules[name]


def write(path, first="", making="", acting="") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(GENTLE.format(first=first, making=making, acting=acting), encoding="utf-8")


def compared(*words, episodes=2, **options) -> list[str]:
    found = evaluate(EvaluateConfig(controllers=words, episodes=episodes), **options)
    return [one.controller for one in found.outcomes]


def refusal(*words) -> str:
    """The line that an evaluation is refused with."""
    with pytest.raises(VergenceError) as caught:
        compared(*words)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def run(capsys, *words) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stop:
        main(["evaluate", *words, "--episodes", "2", "--workers", "1", "--out", "run"])
    return int(stop.value.code or 0), *capsys.readouterr()


def test_a_file_without_a_class_is_answered_by_its_classes_that_predict(tmp_path):
    write(tmp_path / "mine.py", first="class Helper: pass")
    with pytest.raises(ConfigurationError, match=r"mine\.py:Class .*\(mine\.py:Gentle\)"):
        make_contestants(("mine.py",))


def test_a_module_in_the_current_folder_is_found_with_the_folder_last_on_the_path(tmp_path):
    write(tmp_path / "mine_a.py")
    assert compared("mine_a:Gentle") == ["mine_a:Gentle", "ibvs-tuned"]
    assert sys.path[-1] == str(tmp_path)
    assert sys.path.count(str(tmp_path)) == 1


@pytest.mark.slow
def test_a_file_is_found_by_its_path_with_what_lies_beside_it(tmp_path):
    write(tmp_path / "there" / "mine_b.py", first="import mine_helper")
    (tmp_path / "there" / "mine_helper.py").touch()
    assert compared("there/mine_b.py:Gentle") == ["mine_b.py:Gentle", "ibvs-tuned"]
    whole = str(tmp_path / "there" / "mine_b.py")
    assert compared(f"{whole}:Gentle")[0] == "mine_b.py:Gentle"


def test_a_file_that_was_edited_is_read_anew(tmp_path):
    write(tmp_path / "mine_c.py")
    compared("mine_c.py:Gentle")
    write(tmp_path / "mine_c.py", making="raise RuntimeError('edited')")
    with pytest.raises(UserControllerError, match="edited"):
        compared("mine_c.py:Gentle")


@pytest.mark.slow
def test_what_is_wrong_in_the_file_is_said_with_its_place_in_one_line(tmp_path):
    cases = (
        ("from math import nothing\n", "mine_e.py:1: ImportError: cannot import name 'nothing'"),
        ("x = 1\nclass Gentle\n", "mine_e.py:2: SyntaxError: expected ':'"),
        ("\n1 / 0\n", "mine_e.py:2: ZeroDivisionError: division by zero"),
        ("import sys\nsys.exit('bye')\n", "mine_e.py:2: SystemExit: bye"),
        ("class Rash:\n    predict = None\n", "expected Gentle in mine_e.py, got Rash"),
        ("Gentle = 4\n", "expected a class in mine_e.py, got 4"),
        ("class Gentle:\n    def __init__(self):\n        pass\n", "with head= and layout=, got"),
        (
            "class Gentle:\n    def __init__(self, head, layout):\n        head.nose\n",
            "mine_e.py:3 in __init__: AttributeError: 'HeadModel' object has no attribute 'nose'",
        ),
        (
            "class Gentle:\n    def __init__(self, head, layout):\n        pass\n",
            "expected an object with predict, got",
        ),
        (
            "class Gentle:\n    def __init__(self, head, layout):\n        pass\n"
            "    def predict(self, observation):\n        pass\n",
            "expected predict(observation, state=None, episode_start=None, deterministic=True), "
            "got predict(observation) (mine_e.py)",
        ),
    )
    for number, (content, said) in enumerate(cases):
        module = f"mine_e{number}"  # Python may keep what it has read under a name
        with named(content, said):
            (tmp_path / f"{module}.py").write_text(content, encoding="utf-8")
            line = refusal(module + (".py:Gentle", ":Gentle")[number % 2])
            assert said.replace("mine_e", module) in line


def test_a_place_that_is_none_is_refused_in_one_line():
    for word, said in [
        ("mine_f:Gentle", "no module mine_f, in"), ("mine_f.py:Gentle", "no such file"),
        ("there/mine_f:Gentle", "path/to/file.py:class"), (":Gentle", "module:class"),
        ("mine_f:", "module:class"), ("json:Gentle", "expected Gentle in"),
    ]:  # fmt: skip
        with named(word):
            assert said in refusal(word)


@pytest.mark.slow
def test_an_action_that_cannot_be_is_said_by_its_place(tmp_path):
    cases = (
        ("raise KeyError('nose')", "mine_g.py:13 in predict: KeyError: 'nose'"),
        ("return observation", "expected (actions, state), got"),
        (
            "return observation[:, :3], state",
            "left_tilt, left_pan, right_tilt, right_pan, got (3, 3)",
        ),
        ("return [['a'] * 4] * len(observation), state", "expected actions as real numbers"),
        ("return [[1], [1, 2]], state", "expected (actions, state), got"),
        ("return observation[:, :4] * float('nan'), state", "got nan"),
    )
    for number, (acting, said) in enumerate(cases):
        module = f"mine_g{number}"
        with named(acting, said):
            write(tmp_path / f"{module}.py", acting=acting)
            line = refusal(f"{module}:Gentle")
            assert line.startswith(f"controller {module}:Gentle: predict, call 1: ")
            assert said.replace("mine_g", module) in line
            assert f"{module}.py" in line


def test_an_action_that_cannot_be_is_said_before_any_other_controller_runs(tmp_path, capsys):
    write(tmp_path / "mine_g.py", acting="raise KeyError('nose')")
    code, out, err = run(capsys, "mine_g:Gentle", "saccade")
    assert (code, out) == (2, "")
    assert err.startswith("vergence: error: controller mine_g:Gentle: predict, call 1: ")
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "run").exists()


TWO = "class Two(Exception):\n    def __init__(self, a, b):\n        super().__init__(a)\n"
LATER = "if self.calls > 40: raise Two('late', 1)"


@pytest.mark.slow
def test_a_controller_that_raises_later_loses_nothing_of_the_others(tmp_path, capsys):
    write(tmp_path / "mine_h.py", first=TWO, acting=LATER)
    code, out, err = run(capsys, "mine_h:Gentle", "saccade")
    assert code == 2
    assert "saccade" in out
    place = "controller mine_h:Gentle: predict, call 41: mine_h.py:16 in predict: Two: late"
    assert f"error: {place} (left out of workspace on kinematic)" in err
    assert "Traceback" not in err
    assert place in (tmp_path / "run" / "config.toml").read_text()
    assert place in (tmp_path / "run" / "report.html").read_text()
    assert '"saccade"' in (tmp_path / "run" / "evaluation.json").read_text()


def test_where_nothing_but_the_baseline_is_left_nothing_is_written(tmp_path, capsys):
    write(tmp_path / "mine_i.py", first=TWO, acting=LATER)
    code, out, err = run(capsys, "mine_i:Gentle")
    assert (code, out) == (2, "")
    assert "mine_i.py:16 in predict: Two: late" in err
    assert not (tmp_path / "run").exists()


@pytest.mark.nightly
def test_worker_processes_find_it_and_say_also_an_exception_that_cannot_leave_them(tmp_path):
    write(tmp_path / "mine_d.py")
    write(tmp_path / "mine_j.py", first=TWO, acting=LATER)
    words = ("mine_d:Gentle", "mine_d.py:Gentle", "mine_j.py:Gentle")
    config = EvaluateConfig(controllers=words, episodes=2)
    found = evaluate(config, mapper=ProcessMapper(2), keep_going=True)
    assert [one.controller for one in found.outcomes] == [*words[:2], "ibvs-tuned"]
    (failure,) = found.failures
    assert "mine_j.py:16 in predict: Two: late" in failure


def test_a_robots_fault_is_not_blamed_on_the_controller():
    class Still:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.zeros((1, 4)), state

    watched = GuardedController(Still(), "mine")
    watched.predict(np.zeros((1, 1)))
    with pytest.raises(HardwareError, match=r"^the line is gone$"), watched.attributing_errors():
        raise HardwareError("the line is gone")
    with (
        pytest.raises(UserControllerError, match=r"controller mine: .*got nan"),
        watched.attributing_errors(),
    ):
        raise ConfigurationError("action: got nan")


def test_an_object_that_raises_is_told_by_its_place_and_keeps_its_error():
    class Rash:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            raise OSError(5, "no camera")

    said = r"test_user_code\.py:\d+ in predict: OSError"
    with pytest.raises(UserControllerError, match=said) as caught:
        evaluate(EvaluateConfig(episodes=2), {"mine": Rash()})
    assert isinstance(caught.value.__cause__, OSError)


def test_a_helper_of_the_users_is_the_place_and_not_the_library_below_it(tmp_path):
    (tmp_path / "mine_below.py").write_text(
        dedent("""
        import numpy as np


        def solve(a):
            return np.linalg.inv(np.zeros((2, 3)))
        """),
        encoding="utf-8",
    )
    write(tmp_path / "mine_k.py", first="import mine_below", acting="mine_below.solve(1)")
    with pytest.raises(VergenceError, match=r": mine_below\.py:6 in solve: LinAlgError: "):
        compared("mine_k:Gentle")


@pytest.mark.parametrize("workers", ["1", pytest.param("2", marks=pytest.mark.nightly)])
def test_what_a_controller_prints_is_no_part_of_the_json(tmp_path, capfd, workers):
    write(tmp_path / "mine_p.py", first="print('imported')", making="print('made')")
    words = ["evaluate", "mine_p:Gentle", "--episodes", "2", "--workers", workers, "--json"]
    with pytest.raises(SystemExit) as stop:
        main([*words, "--out", str(tmp_path / "run")])
    assert not stop.value.code
    rows = json.loads(capfd.readouterr().out)
    assert "mine_p:Gentle" in [row["controller"] for row in rows]
