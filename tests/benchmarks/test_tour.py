"""The tour of the robot tells by its exit status whether every step went well."""

from rich.console import Console

from benchmarks.tour import Tour
from vergence.errors import HardwareError


def steps(*acts):
    tour = Tour(Console(quiet=True))
    for number, act in enumerate(acts):
        tour.step(str(number), act)
    return tour


def refuse():
    raise HardwareError("the line is gone")


def test_one_step_that_fails_is_told_by_the_status():
    assert steps(lambda: (True, "well"), lambda: (True, "well")).status == 0
    assert steps(lambda: (True, "well"), lambda: (False, "18 of 20")).status == 1
    assert steps().status == 1


def test_what_a_step_refuses_fails_and_says_why():
    tour = steps(refuse, lambda: (True, "well"))
    assert tour.status == 1
    assert [(step.went_well, step.found) for step in tour.steps] == [
        (False, "the line is gone"),
        (True, "well"),
    ]
