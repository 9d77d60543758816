"""No call with an array of whatever shape and type reads or writes outside of its arrays."""

import importlib
import itertools
import pkgutil
import re
from functools import partial

import numpy as np
import pytest

import vergence
from tests.envs.robot import Robot
from tests.heads import head_of
from tests.naming import named, refused
from vergence.controllers.controller import CONTROLLERS
from vergence.envs.gaze import GazeEnv
from vergence.envs.observation import ObservationLayout
from vergence.envs.reading import Reading
from vergence.envs.targets.motion import target_position
from vergence.errors import ConfigurationError
from vergence.kernels import GufuncKernel
from vergence.models.camera import Camera
from vergence.vision.optics import FlatView

LENGTHS = range(10)
NO_NUMBERS = ("text", None, 1j, ["a"], [[1.0, 2.0], [3.0]], {})
ROOM = 64
"""Numbers before and after an array in its memory."""


KERNELS = {
    f"{info.name.removeprefix('vergence.')}.{name}": value
    for info in pkgutil.walk_packages(vergence.__path__, "vergence.")
    # no kernels there, but torch
    if not info.name.startswith("vergence.training") and not info.name.endswith("__main__")
    for name, value in vars(importlib.import_module(info.name)).items()
    if isinstance(value, GufuncKernel) and value.__module__ == info.name
}


def sizes(core, length):
    return tuple(size if isinstance(size, int) else length for size in core)


def fitting(kernel, length=1):
    """Truth values, which stand for numbers, that fit a kernel; what is open has the length."""
    cores = kernel.input_core_dimensions.values()
    return [np.zeros(sizes(core, length), np.bool_) for core in cores]


@pytest.mark.slow
def test_a_kernel_refuses_another_shape_and_what_is_no_number_by_the_name_of_the_argument():
    for label, kernel in KERNELS.items():
        for place, (name, core) in enumerate(kernel.input_core_dimensions.items()):
            operands = fitting(kernel)
            shape = re.escape(f"{name}: expected shape (..., {', '.join(map(str, core))}), got")
            other_forms = (*NO_NUMBERS, *([0.0] if core else ()))
            wrong = [(value, f": {name}: expected") for value in other_forms]
            for axis, length in itertools.product(range(len(core)), LENGTHS):
                if length != core[axis] and not isinstance(core[axis], str):
                    other = list(sizes(core, 1))
                    other[axis] = length
                    wrong.append((np.zeros(other, np.bool_), shape))
            for operands[place], expected in wrong:
                with named(label), pytest.raises(ConfigurationError, match=expected):
                    kernel(*operands)


def results_of(kernel, *operands, **options):
    """Results of a kernel, also of one that gives a single array."""
    with np.errstate(all="ignore"):
        results = kernel(*operands, **options)
    return results if isinstance(results, tuple) else (results,)


def test_a_kernel_takes_empty_batches_and_arrays_that_lie_apart():
    for label, kernel in KERNELS.items():
        with named(label):
            operands = fitting(kernel, LAYOUT.size)
            apart = [np.zeros((*one.shape, 2), np.bool_)[..., 0] for one in operands]
            np.testing.assert_equal(results_of(kernel, *apart), results_of(kernel, *operands))
            operands[0] = np.zeros((0, *operands[0].shape), np.bool_)
            assert not any(len(result) for result in results_of(kernel, *operands))


def in_room(shape, filled, value=0.0):
    """An array in the midst of other numbers, and all of its memory."""
    size = int(np.prod(shape))
    memory = np.full(ROOM + size + ROOM, filled)
    array = memory[ROOM : ROOM + size].reshape(shape)
    array[...] = value
    return memory, array


def is_open(core):
    return any(isinstance(size, str) for size in core)


OPEN = {
    name: kernel
    for name, kernel in KERNELS.items()
    if any(map(is_open, kernel.input_core_dimensions.values()))
    and name != "envs.observation._decode"  # its one caller looks at the length before
}


@pytest.mark.parametrize("kernel", OPEN.values(), ids=list(OPEN))
@pytest.mark.parametrize("length", [*LENGTHS, 10, 11, 12, 15, 16, 24, 25, 26, 33, 37, 45, 63])
def test_a_kernel_that_takes_any_length_reads_and_writes_nothing_beside_its_arrays(kernel, length):
    fits = fitting(kernel, length)
    results = results_of(kernel, *fits)
    told = []
    for filled in (0.0, 7e8):
        operands = [
            in_room(one.shape, filled)[1] if is_open(core) else one
            for core, one in zip(kernel.input_core_dimensions.values(), fits, strict=True)
        ]
        rooms = [in_room(np.shape(result), filled, 0.25) for result in results]
        results_of(kernel, *operands, out=tuple(array for _, array in rooms), casting="unsafe")
        for memory, array in rooms:
            assert (memory[:ROOM] == filled).all()
            assert (memory[ROOM + array.size :] == filled).all()
        told.append([array.copy() for _, array in rooms])
    np.testing.assert_equal(told[0], told[1])


HEAD = vergence.load_head("simulated")
TIED = head_of("tied")
CAMERA = Camera.of(HEAD, 0)
LAYOUT = ObservationLayout.of(HEAD)
LAW = vergence.make_controller("adaptive", head=HEAD, layout=LAYOUT)
Q, POINT, PIXELS = np.zeros(7), np.array([0.0, 0.0, 1.0]), np.full((2, 2), 400.0)


HEADS = (HEAD, TIED)
CALLS = [
    *[(call, [Q]) for call in (HEAD.base_pose, HEAD.camera_poses, HEAD.link_poses, HEAD.reaches)],
    *[(call, [Q]) for head in HEADS for call in (head.actuation.joints_of,
      head.actuation.joint_velocities_of, head.actuation.actuators_of)],
    *[(call, [POINT]) for head in HEADS for call in (head.fixate, head.least_error)],
    (HEAD.project, [Q, POINT]),
    (HEAD.undistort, [PIXELS]),
    (HEAD.image_jacobian, [Q, PIXELS, np.ones(2)]),
    (HEAD.limits.contains, [Q]),
    (HEAD.with_parameters, [HEAD.parameters().values]),
    (partial(vergence.triangulate_gaze, HEAD), [Q]),
    (partial(vergence.triangulate_views, HEAD), [Q, PIXELS]),
    (CAMERA.project, [POINT[None]]),
    (CAMERA.rays, [PIXELS]),
    (partial(FlatView, CAMERA), [PIXELS]),
    (LAW.gains, [PIXELS]),
    (LAW.command, [Q, PIXELS]),
    (LAYOUT.decode, [np.zeros(LAYOUT.size)]),
    (LAYOUT.action, [np.zeros(4)]),
]  # fmt: skip
"""Public geometry: calls, and arrays that fit them."""


def test_public_geometry_takes_real_numbers_in_any_array_and_refuses_what_does_not_fit():
    for call, arguments in CALLS:
        with named(call):
            expected = call(*arguments)
            for other in (np.ndarray.tolist, np.asfortranarray, np.float32):
                told = call(*[other(one) for one in arguments])
                pairs = zip(told, expected, strict=True) if isinstance(told, tuple) else ()
                for one, same in pairs or [(told, expected)]:
                    if isinstance(one, np.ndarray):
                        np.testing.assert_allclose(one, same, rtol=1e-5, atol=1e-5)
            for place, fits in enumerate(arguments):
                wrong = [np.zeros((*fits.shape[:-1], n)) for n in LENGTHS if n != fits.shape[-1]]
                for value in (*wrong, 0.0, *NO_NUMBERS):
                    given = [value if i == place else one for i, one in enumerate(arguments)]
                    with pytest.raises(ConfigurationError, match="expected"):
                        call(*given)


def test_a_motion_of_a_length_that_none_has_is_nowhere():
    for length in (*LENGTHS, 24, 26, 36):
        assert np.isnan(target_position(np.zeros(length), 1.0)).all(), length


def test_a_controller_refuses_another_length_and_another_state():
    for name in [name for name in CONTROLLERS if "learned" not in name]:
        with named(name):
            controller = vergence.make_controller(name, head=HEAD, layout=LAYOUT)
            for length in (*LENGTHS, LAYOUT.size - 4, LAYOUT.size + 4):
                refused("observation: expected", controller.predict, np.zeros(length, np.float32))
            _, state = controller.predict(np.zeros(LAYOUT.size, np.float32))
            several = np.zeros((2, *np.shape(state[0]))) if state else None
            for wrong in ((np.zeros(3),), (several,), (None,), 1) if state else ():
                given = np.zeros(LAYOUT.size, np.float32), wrong
                refused("state: expected", controller.predict, *given)


def test_an_action_that_is_no_numbers_is_refused_in_one_line():
    for action in [np.zeros(4, complex), ["1"] * 4, [{}, 1, 2, 3], [[0], 1]]:
        env = GazeEnv(plant="kinematic")
        env.reset(seed=0)
        refused("action: expected", env.step, action)


class Misreporting(Robot):
    field, value = "", None

    def step(self, command):
        told = super().step(command)
        return told._replace(**{self.field: self.value}) if self.field else self.value


class Narrow(Robot):
    """It reports in single precision, in the same arrays each time."""

    told = None

    def step(self, command):
        now = super().step(command)
        self.told = self.told or Reading(*(np.float32(one) for one in now))
        for own, one in zip(self.told, now, strict=True):
            own[...] = one
        return self.told


def on_robot(name):
    env = GazeEnv(plant=f"{__name__}:{name}")
    env.reset(seed=0)
    return env


def test_a_reading_of_another_form_is_refused_by_its_field(monkeypatch):
    for field, value in (
        ("positions", np.zeros((1, 4))), ("positions", np.zeros(7)), ("pixels", np.zeros((1, 2))),
        ("visible", np.zeros((2, 2), np.bool_)), ("time_s", 0.1), ("velocities", None), ("", None),
    ):  # fmt: skip
        monkeypatch.setattr(Misreporting, "field", field)
        monkeypatch.setattr(Misreporting, "value", value)
        said = f"Reading.{field}: expected" if field else "None"
        refused(said, on_robot("Misreporting").step, np.zeros(4))


def test_readings_of_single_precision_are_read_anew_in_each_step():
    env = on_robot("Narrow")
    for _ in range(3):
        env.step(np.ones(4))
        told = env.task.plant.told
        np.testing.assert_array_equal(env.task.reading.positions, told.positions)
    assert told.positions[0, 3] > 0.0
