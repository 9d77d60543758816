"""Logs of trials that a simulation runs in place of a robot."""

import numpy as np

from vergence.controllers.controller import make_controller
from vergence.envs.reading import Truth
from vergence.envs.task import GazeTask, run_trial
from vergence.models.head_file import load_head
from vergence.recording import Recorder
from vergence.recording.schema import LoggedCommand
from vergence.recording.writer import LogWriter

HEAD = load_head("turrets")
STEPS = 60


def open_log(path, clock=lambda: 5.0, **facts):
    """A new log of the head `turrets`, by default by a clock that stands still."""
    return LogWriter(
        path, head=HEAD, config="# a robot", facts=facts, clock=clock, wall_ns=lambda: 10**18
    )


def log_trials(
    path, law="state-feedback", trials=2, steps=STEPS, planned=None, fault=False, facts=None,
    levels=(), truths=10**6, **more,
):  # fmt: skip
    """Log trials of a law on a kinematic head, and grey images; what was recorded of each."""
    more |= {} if planned is None else {"steps": planned}
    policy = make_controller(law, HEAD)
    task = GazeTask(1, head=HEAD, plant="kinematic", target={"kind": "random", "start": "rest"})
    records = []
    with open_log(path, **{"controller": law, "options": "{}", **more, **(facts or {})}) as log:
        for number in range(trials):
            record = Recorder(task, steps)

            def keep(step, record=record):
                record(step)
                if step == 0:
                    log.begin()
                    for eye, level in enumerate(levels):
                        log.image(eye, np.full((48, 64), level, np.uint8), 2.0)
                else:
                    sent = task.reading.command[0].copy()
                    log.command(LoggedCommand(5.0, task.command[0].copy(), sent, "go", "policy"))
                log.reading(task.reading, 2.0)
                if step < truths:
                    log.truth(Truth._make(np.array(rows[step]) for rows in record.truth))

            run_trial(task, policy, steps, keep, seed=3, first_trial=number)
            records.append(record)
        if fault:
            log.stopped("bus: gone")
    return records
