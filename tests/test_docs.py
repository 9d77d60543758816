"""The examples of README and guide run as they stand there, on smaller numbers."""

import doctest
import re
import shlex
import tomllib
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import vergence
from benchmarks.made import made
from benchmarks.stable_baselines import RECIPE
from tests.hardware.fakes import FakeClock
from vergence import load_head, make_controller
from vergence.commands.parsing import parse_command
from vergence.controllers.controller import WHICH_LAW
from vergence.envs.observation import FIELDS, ObservationLayout
from vergence.envs.plant import make_plant
from vergence.errors import VergenceError
from vergence.hardware.config import load_hardware
from vergence.hardware.emulator.faults import load_faults

ROOT = Path(__file__).resolve().parents[1]
SMALLER = {
    "10_000": "64", "episodes=200": "episodes=5", "range(240)": "range(30)",
    "learn(1_000_000)": "learn(64)", "episodes=1000": "episodes=5",
    "batch_size=4096": "batch_size=64",
    "EvaluateConfig()": "EvaluateConfig(controllers=('saccade',), episodes=5)",
    "num_envs=1024": "num_envs=4", "num_envs=256": "num_envs=4", '"policy", 256': '"policy", 4',
}  # fmt: skip
"""Numbers of the examples, and what stands for them here: time, not meaning, is in them."""

PAGES = [
    *(path.name for path in ROOT.glob("*.md")),
    *(f"docs/{path.name}" for path in ROOT.glob("docs/*.md")),
]


def page(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def blocks(name: str, kind: str) -> list[str]:
    """Fenced blocks of a document."""
    return re.findall(rf"^ *```{kind}\n(.*?)^ *```$", page(name), re.MULTILINE | re.DOTALL)


def examples(name: str) -> list[str]:
    """The Python blocks of a document."""
    found = blocks(name, "python")
    for number, less in SMALLER.items():
        found = [block.replace(number, less) for block in found]
    return found


TOGETHER = {"README.md", "docs/guide.md"}
"""Pages whose examples build on one another."""
NIGHTLY = {"docs/guide.md", "docs/evaluate.md"}
RUN = sorted({name for name in PAGES if examples(name)} - {"docs/stable-baselines3.md"})


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=[pytest.mark.nightly] * (one in NIGHTLY)) for one in RUN]
)
@pytest.mark.filterwarnings("ignore:You are trying to run PPO on the GPU:UserWarning")
def test_the_examples_of_a_page_run(name, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in examples(name):
        code = compile(block, name, "exec")
        if name not in TOGETHER:
            model = make_controller("ibvs", load_head("simulated"))
            names = {"__name__": "example", "model": model}
        if "runs/" not in block and "torch.onnx" not in block:  # these need a trained network
            exec(code, names)
    assert capsys.readouterr().out.strip() or name not in TOGETHER  # these show something


@pytest.mark.slow
def test_blocks_of_pages_are_of_kinds_that_are_checked_and_their_commands_exist() -> None:
    known = {"python", "toml", "sh", "json", "text", ""}
    found = 0
    for name in PAGES:
        assert set(re.findall(r"^ *```(\w*)\n.*?```$", page(name), re.M | re.S)) <= known
        for block in blocks(name, "toml"):
            tomllib.loads(block)
        for block in blocks(name, r"\w*"):
            joined = re.sub(r"\$\w+", "0", block.replace("\\\n", ""))
            for words in re.findall(r"^ *(?:\$ )?vergence ([^#&\n]*)", joined, re.MULTILINE):
                parse_command(shlex.split(words))
                found += 1
    assert found > 90


def test_the_recipe_for_stable_baselines_is_what_runs() -> None:
    (shown,) = blocks("docs/stable-baselines3.md", "python")
    assert shown in RECIPE.read_text(encoding="utf-8")


def test_the_pages_table_of_the_observation_is_that_of_the_layout() -> None:
    rows = re.findall(r"^ *(\| \d+:\d+ .*\|)$", str(ObservationLayout.__doc__), re.MULTILINE)
    text = page("docs/environment.md")
    assert [row for row in rows if row not in text] == []
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    fields = {name: f"{part.start}:{part.stop}" for name, part in FIELDS.items()}
    assert {row[1].strip("`"): row[0] for row in cells} == fields
    layout = ObservationLayout.of(load_head("simulated"))
    for row in cells:
        part = FIELDS[row[1].strip("`")]
        low, high = map(float, row[4].split(" to "))
        assert (layout.low()[part] == low).all()
        assert (layout.high()[part] == high).all()


def test_tables_of_imperfections_are_those_of_the_code() -> None:
    for name in ("docs/environment.md", "docs/evaluate.md"):
        assert "<!-- rows " in page(name)
        assert made(page(name)) == page(name)


def test_each_public_name_has_an_example_that_holds() -> None:
    for name in set(vergence.__all__) - {"__version__"}:
        (example,) = doctest.DocTestFinder(recurse=False).find(getattr(vergence, name), name)
        failed, attempted = doctest.DocTestRunner().run(example)
        assert attempted > 0, name
        assert failed == 0, name


@pytest.fixture
def own_plant(tmp_path):
    """The plant of the docs in a file."""
    code = next(block for block in examples("docs/environment.md") if "class MyHead" in block)
    (tmp_path / "my_plant.py").write_text(code, encoding="utf-8")
    return f"{tmp_path / 'my_plant.py'}:MyHead"


def test_the_plant_of_the_docs_keeps_time_and_brings_the_target_to_the_centre(own_plant) -> None:
    clock = FakeClock()
    options = {"clock": clock, "sleep": clock.sleep}
    env = gymnasium.make("vergence/Gaze-v0", plant=own_plant, plant_options=options)
    controller = make_controller("ibvs", env.unwrapped.task.head)
    observation, _info = env.reset(seed=0)
    for step in range(1, 240):
        observation, _reward, _lost, _over, info = env.step(controller.predict(observation)[0])
        assert clock.now == pytest.approx(100.0 + step / 120)
        clock.now += 0.001 * (step % 5)  # a controller that takes its time
    assert info["is_success"]
    assert env.unwrapped.task.plant.overruns == 0


def test_the_plant_of_the_docs_skips_late_periods_and_stops_when_they_go_on(own_plant) -> None:
    clock = FakeClock()
    plant = make_plant(own_plant, load_head("simulated"), clock=clock, sleep=clock.sleep)
    plant.reset(np.arange(1), np.zeros((1, 7)))
    command = np.array([[0.0, 0.0, 0.0, 0.1, 0.1, 0.1, 0.1]])
    began = clock.now
    clock.now += 0.0995  # a little less than twelve periods
    late = plant.step(command).time_s[0]
    on_time = plant.step(command).time_s[0]
    assert plant.overruns == 1
    assert clock.now == pytest.approx(began + 13 / 120)  # the next period is a whole one
    assert [late, on_time] == pytest.approx([12 / 120, 13 / 120], abs=1e-12)
    for _ in range(11):
        clock.now += 0.1
        reading = plant.step(command)
    assert reading.command.any()
    clock.now += 0.1
    with pytest.raises(VergenceError, match="12 late periods"):
        plant.step(command)
    before = plant._read_joints()[0]
    clock.now += 1.0
    assert np.array_equal(plant._read_joints()[0], before)  # the eyes have stopped


def test_a_controller_of_ones_own_takes_fifteen_lines() -> None:
    block = next(block for block in examples("docs/guide.md") if "class " in block)
    body = block[block.index("class ") : block.index("head = ")]
    assert len(list(filter(str.strip, body.splitlines()))) <= 15


def anchors_of(text: str) -> set[str]:
    """Anchors that GitHub gives a page's headings."""
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    plain = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in headings]
    return {re.sub(r"[^\w -]", "", heading).replace(" ", "-") for heading in plain}


def test_links_between_pages_lead_to_a_file_and_a_heading() -> None:
    texts = {ROOT / name: re.sub(r"```.*?```", "", page(name), flags=re.DOTALL) for name in PAGES}
    broken, found = [], 0
    for path, text in texts.items():
        for link in re.findall(r"\]\((?!https?:)([^)\s]+)\)", text):
            file, _, anchor = link.partition("#")
            target = (path.parent / file).resolve() if file else path
            found += 1
            if not target.exists() or (anchor and anchor not in anchors_of(texts[target])):
                broken.append(f"{path.name}: {link}")
    assert found > 100
    assert broken == []


def test_modules_and_places_that_pages_name_exist() -> None:
    known = {"mine.py", "my_plant.py", "file.py"}  # a reader's own
    for folder in ("vergence", "tests", "benchmarks", "docs"):
        known |= {path.name for path in (ROOT / folder).rglob("*.py")}
    text = "\n".join(map(page, PAGES))
    assert set(re.findall(r"\w+\.py\b", text)) - known == set()
    text = page("docs/architecture.md") + page("docs/images/architecture.svg")
    named = set(re.findall(r"[\w/]+/(?:\w+\.py)?(?=[`,<])", text))
    assert len(named) > 20
    rooms = [ROOT / "vergence" / room for room in ("", "envs", "eval")]
    assert [path for path in named if not any((room / path).exists() for room in rooms)] == []
    text = page("CONTRIBUTING.md")
    assert len(re.findall(r"^\| .*\? \| `[^`]+` \|$", text, flags=re.MULTILINE)) >= 20
    places = re.findall(r"`((?:vergence|tests|docs|benchmarks)/[^`*]*)`", text)
    assert [place for place in places if not (ROOT / place).exists()] == []


def test_the_configuration_of_a_robot_is_read_as_it_stands(tmp_path) -> None:
    script, *blocks = re.findall(r"```toml\n(.*?)```", page("docs/robot.md"), flags=re.DOTALL)
    others = "".join(
        f'[[servos]]\nname = "{name}"\nid = {id}\nzero_ticks = 2048\nsign = 1\n'
        for id, name in enumerate(("left_tilt", "right_pan", "right_tilt"), 2)
    )
    file = tmp_path / "desk.toml"
    file.write_text("\n".join(blocks).replace("# ... and the others", others), encoding="utf-8")
    config = load_hardware(file)
    assert [servo.id for servo in config.servos] == [1, 2, 3, 4]
    assert config.cameras[0].latency_s == 0.09
    assert [one.name for one in config.safety.forbidden] == ["left eye at the frame"]
    file = tmp_path / "faults.toml"
    file.write_text(script, encoding="utf-8")
    assert [fault.what for fault in load_faults(file, [1, 2, 3, 4])] == ["lost"]


def test_every_page_gives_the_same_answer_to_which_law() -> None:
    for name in ("README.md", "docs/turrets.md", "docs/controllers.md", "docs/robot.md"):
        assert WHICH_LAW in page(name), name
