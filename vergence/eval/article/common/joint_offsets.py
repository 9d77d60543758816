"""The article's head with other joint offsets than its table of Denavit-Hartenberg rows says."""

from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.links import DenavitHartenberg
from vergence.models.parts import FloatArray


def with_joint_offsets(head: HeadModel, more: FloatArray) -> HeadModel:
    """A head, or a population, whose joints stand otherwise than their encoders say.

    Args:
        head: one of the article's form.
        more: (..., 9) what is added to the offsets of its rows, rad.

    Returns:
        The head with the other offsets.

    Raises:
        ConfigurationError: the head is of another form.
    """
    if not isinstance(head.links, DenavitHartenberg):
        raise ConfigurationError(
            f"head: expected one of the article's form, nine Denavit-Hartenberg rows, got "
            f"{head.name!r}, whose joints are given by axes"
        )
    return head.replace(links={"offset": head.links.offset + more})
