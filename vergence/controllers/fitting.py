"""Check that the observation layout of a controller belongs to its head."""

from vergence.envs.observation import ObservationLayout
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel


def checked_layout(head: HeadModel, layout: ObservationLayout | None) -> ObservationLayout:
    """Return the layout for a controller of a head.

    Args:
        head: the head to control.
        layout: the layout of its observations; None for the head's own layout.

    Returns:
        The layout.

    Raises:
        ConfigurationError: the layout belongs to another head, so its numbers mean something else,
            or the head's eyes do not move.
    """
    if not head.actuation.count:
        raise ConfigurationError(
            f"head: expected one whose eyes move, got {head.name!r}, a fixed pair, which leaves a "
            "controller nothing to do"
        )
    own = ObservationLayout.of(head)
    if layout is None:
        return own
    if not isinstance(layout, ObservationLayout):
        raise ConfigurationError(f"layout: expected an ObservationLayout, got {layout!r:.80}")
    if layout == own:
        return layout
    ours, theirs = own.to_dict(), layout.to_dict()
    differing = ", ".join(name for name, value in ours.items() if theirs.get(name) != value)
    raise ConfigurationError(
        f"layout: expected that of the head {head.name!r}, got another head's, which differs in "
        f"{differing}"
    )
