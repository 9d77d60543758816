"""Changed joint offsets in the Denavit-Hartenberg table of the article's head."""

from vergence.errors import ConfigurationError
from vergence.models.geometry import DenavitHartenberg
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


def with_joint_offsets(head: HeadModel, added_rad: FloatArray) -> HeadModel:
    """Add joint offsets to a head or a population: its joints then differ from their encoders.

    Args:
        head: a head with Denavit-Hartenberg rows, as the article's.
        added_rad: (..., 9) additions to the offsets of its rows, rad.

    Returns:
        The head with the changed offsets.

    Raises:
        ConfigurationError: the head is not given by Denavit-Hartenberg rows.
    """
    if not isinstance(head.links, DenavitHartenberg):
        raise ConfigurationError(
            f"head: expected one of the article's form, nine Denavit-Hartenberg rows, got "
            f"{head.name!r}, whose joints are given by axes"
        )
    return head.replace(links={"offset": head.links.offset + added_rad})
