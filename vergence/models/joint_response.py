r"""How joints follow velocity commands: a first-order lag with an acceleration limit, exactly.

    dv/dt = clip((u - v) / tau, -a, a),   dq/dt = v

with the command u held for a period. While |u - v| exceeds a tau the joint accelerates at the
limit; then the difference decays exponentially. Both phases have closed forms, so a period is
one step whatever its length. A joint at its position limit stops there.
"""

from math import exp, inf

from vergence._jit import compiled, device
from vergence.models.parts import FloatArray


@device
def follow_joint(
    q: float, v: float, u: float, tau: float, a: float, period: float, decay: float
) -> tuple[float, float]:
    """One joint a period later, without position limits; for use inside kernels.

    Args:
        q: angle, rad.
        v: velocity, rad/s.
        u: velocity command, rad/s.
        tau: time constant, s; 0 for none.
        a: greatest acceleration, rad/s^2, inf for none.
        period: the period, s.
        decay: `exp(-period / tau)`, which callers compute once for many joints; 0 for no lag.

    Returns:
        Angle and velocity, rad and rad/s.
    """
    gap = u - v
    side = 1.0 if gap >= 0.0 else -1.0
    # how long the joint accelerates at its limit; without a limit, not at all
    ramp = 0.0
    if a < inf:
        ramp = min(max((side * gap - a * tau) / a, 0.0), period)
    gain = side * a * ramp if ramp > 0.0 else 0.0
    q += v * ramp + 0.5 * gain * ramp
    v += gain
    rest = period - ramp
    if rest > 0.0:
        gap = u - v
        left = decay
        if ramp > 0.0:
            left = exp(-rest / tau) if tau > 0.0 else 0.0
        q += u * rest - gap * tau * (1.0 - left)
        v = u - gap * left
    return q, v


@compiled
def follow(
    q: FloatArray,
    v: FloatArray,
    command: FloatArray,
    lag: FloatArray,
    acceleration: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    period: float,
) -> None:
    """Move a batch of heads through one period, in place.

    Args:
        q: (n, 7) joint angles, rad.
        v: (n, 7) joint velocities, rad/s.
        command: (n, 7) velocity commands within the limits, rad/s.
        lag: (n,) time constants, s.
        acceleration: (7,) greatest accelerations, rad/s^2, inf for none.
        lower: (7,) least angles, rad.
        upper: (7,) greatest angles, rad.
        period: the period, s.
    """
    for n in range(q.shape[0]):
        decay = exp(-period / lag[n]) if lag[n] > 0.0 else 0.0
        for j in range(7):
            if v[n, j] == 0.0 and command[n, j] == 0.0:
                continue
            qj, vj = follow_joint(
                q[n, j], v[n, j], command[n, j], lag[n], acceleration[j], period, decay
            )
            if qj < lower[j]:
                qj, vj = lower[j], max(vj, 0.0)
            elif qj > upper[j]:
                qj, vj = upper[j], min(vj, 0.0)
            q[n, j], v[n, j] = qj, vj


@compiled
def limit_commands(command: FloatArray, limit: FloatArray, out: FloatArray) -> bool:
    """Clip commands to the joints' speeds, and say whether all were numbers.

    Args:
        command: (n, 7) velocity commands, rad/s.
        limit: (7,) greatest speeds, rad/s.
        out: (n, 7) the clipped commands.

    Returns:
        False if any command is nan.
    """
    numbers = True
    for n in range(command.shape[0]):
        for j in range(7):
            u = command[n, j]
            if u != u:
                numbers = False
            out[n, j] = min(max(u, -limit[j]), limit[j])
    return numbers
