r"""Image-based visual servoing with ViSP's adaptive gain.

The law of `vergence.controllers.ibvs`, with a gain that grows as the error shrinks. Per eye,

    lambda(x) = (lambda_0 - lambda_inf) exp(-lambda'_0 x / |lambda_0 - lambda_inf|) + lambda_inf

with lambda_0 the gain at zero error, lambda_inf the gain far away, and -lambda'_0 the slope at zero
(`vpAdaptiveGain` of ViSP). If lambda_inf is the larger one, the gain rises with that slope instead.
x is the infinity norm of the eye's error in normalised image coordinates, (u - u_0) / f_u and (v -
v_0) / f_v: no unit, close to radians near the axis. Only the part of the error that the head's
actuators can remove counts.
"""

from math import exp, isfinite
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from vergence.controllers.coupled import reducible_pixel_error
from vergence.controllers.ibvs import depth_or_nan, ibvs_velocities, speed_limits
from vergence.controllers.image_law import GatedImageController
from vergence.controllers.outlier_gate import GatedDetections
from vergence.envs.observation import ObservationLayout
from vergence.envs.reading import check_at_least_zero
from vergence.kernels import kernel
from vergence.models.head import HeadModel
from vergence.models.kinematics import PACKED, PackedHead, camera_of
from vergence.models.parts import FloatArray
from vergence.operands import as_operand


class AdaptiveIBVS(GatedImageController):
    """IBVS whose gain depends on the size of each eye's error.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        lambda_zero: gain at zero error, 1/s.
        lambda_inf: gain at large errors, 1/s; if it equals `lambda_zero` the gain is fixed.
        slope_zero: lambda'_0, steepness of the gain's fall at zero error, 1/s per unit of x.
        depth: see `IBVS`.
        speed_limit: see `IBVS`.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    def __init__(
        self,
        *,
        head: HeadModel,
        layout: ObservationLayout,
        lambda_zero: float = 4.2,
        lambda_inf: float = 4.1,
        slope_zero: float = 30.0,
        depth: Literal["triangulated"] | float = "triangulated",
        speed_limit: float | None = None,
    ) -> None:
        values = {"lambda_zero": lambda_zero, "lambda_inf": lambda_inf, "slope_zero": slope_zero}
        for name, value in values.items():
            check_at_least_zero(name, value)
        super().__init__(head=head, layout=layout)
        self._depth = depth_or_nan(depth)
        self._limit = speed_limits(layout, speed_limit)
        self._constants = np.array([lambda_zero, lambda_inf, slope_zero])

    def gains(self, pixel_error: ArrayLike) -> FloatArray:
        """Compute the gains for given errors.

        Args:
            pixel_error: (..., 2, 2) undistorted pixel minus principal point, px.

        Returns:
            (..., 2, 2) gains by eye and image axis, 1/s; both axes of an eye have the same.
        """
        return np.asarray(adaptive_gains(pixel_error, self._constants, self.head.packed))

    def command(self, q: ArrayLike, pixel_error: ArrayLike) -> FloatArray:
        """Compute the velocities of the law, see `IBVS.command`."""
        error = as_operand("pixel_error", pixel_error, 2, 2)
        gains = self.gains(reducible_pixel_error(self.head, q, error, self._depth))
        return ibvs_velocities(self.head, q, error, gains, self._depth, self._limit)

    def _law(self, detections: GatedDetections, own: FloatArray) -> FloatArray:
        return self.command(detections.positions_at_exposure, detections.pixel_error)


@kernel(["(f8[:,:],f8[:],f8[:],f8[:,:])"], f"(2,2),(3),({PACKED})->(2,2)")
def adaptive_gains(
    pixel_error: FloatArray, law: FloatArray, p: PackedHead, out: FloatArray
) -> None:
    """Compute gains from pixel errors; `law` is (lambda_0, lambda_inf, lambda'_0)."""
    zero, far, slope = law[0], law[1], law[2]
    fall = zero - far
    for eye in range(2):
        gain, du, dv = far, abs(pixel_error[eye, 0]), abs(pixel_error[eye, 1])
        # the exponential vanishes in the limit lambda_0 = lambda_inf
        if fall != 0.0 and isfinite(du) and isfinite(dv):
            camera = camera_of(p, eye)
            x = max(du / camera.focal_u, dv / camera.focal_v)
            gain += fall * exp(-slope * x / abs(fall))
        out[eye, 0] = out[eye, 1] = gain
