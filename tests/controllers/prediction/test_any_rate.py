"""Any control rate from 50 to 250 Hz, any frame rate up to it, nominal delays up to 250 ms."""

import numpy as np
import pytest

from tests.controllers.reaching import run
from tests.naming import named
from vergence import load_head
from vergence.controllers.prediction.predictor import SmithPredictor
from vergence.envs.observation import ObservationLayout
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError

HEAD = load_head("simulated")


def last_errors(head, time_s: float, name: str = "saccade", **options) -> np.ndarray:
    """(12,) the greatest true error of the last tenth of a second, px."""
    task = GazeTask(12, head=head, plant="kinematic", plant_options=options)
    steps = round(time_s * head.timing.control_rate_hz)
    errors = np.linalg.norm(run(task, name, steps).errors, axis=-1).max(axis=-1)
    return errors[-round(0.1 * head.timing.control_rate_hz) :].max(axis=0)


@pytest.mark.parametrize(
    ("name", "control_hz", "frame_hz"),
    [("saccade", 50, 15), ("pursuit", 60, 30), ("pursuit", 250, 15), ("saccade", 250, 250)],
)
def test_a_saccade_settles_whatever_the_rates_and_the_delay(control_hz, frame_hz, name) -> None:
    head = HEAD.replace(timing={"control_rate_hz": control_hz, "frame_rate_hz": frame_hz})
    frame_s = 1.0 / frame_hz
    away = last_errors(
        head, 0.6 + 4.0 * frame_s, name, latency_s=0.1, command_latency_s=0.008, frame_phase=0.4
    )
    assert away.max() < 1.0


@pytest.mark.parametrize(("control_hz", "latency_s"), [(50, 0.0), (120, 0.25), (250, 0.12)])
def test_nominal_delays_up_to_a_quarter_of_a_second_are_borne(control_hz, latency_s) -> None:
    head = HEAD.replace(
        timing={"control_rate_hz": control_hz, "frame_rate_hz": 50, "latency_s": latency_s}
    )
    assert last_errors(head, 0.6 + latency_s, latency_s=latency_s + 0.01).max() < 1.0


def test_longer_ones_are_refused_in_one_line() -> None:
    for latency_s in [0.26, 0.5]:
        with named(latency_s):
            head = HEAD.replace(timing={"latency_s": latency_s})
            message = rf"head: expected a latency of at most 0\.25 s, got {latency_s:g} s"
            with pytest.raises(ConfigurationError, match=message) as caught:
                SmithPredictor(head=head, layout=ObservationLayout.of(head))
            assert "\n" not in str(caught.value)
