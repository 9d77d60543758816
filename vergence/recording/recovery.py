"""A whole log out of one that a crash has cut off."""

import os
from typing import Any, cast

from vergence.recording.records import records_of


def recover(path: str | os.PathLike[str], out: str | os.PathLike[str]) -> None:
    """Copy all that can be read of an MCAP file to a new one, with its index and its end.

    Args:
        path: the file that is cut off.
        out: the new file.

    Raises:
        UnreadableFileError: it is no MCAP file.
        OSError: the new file cannot be written.
    """
    from mcap.records import Attachment, Channel, Message, Metadata, Schema
    from mcap.writer import Writer

    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    with open(out, "xb") as file:
        writer = cast(Any, Writer(file))  # some of its methods have no types
        writer.start()
        for one in records_of(path):
            if isinstance(one, Schema):
                if one.id not in schemas:
                    schemas[one.id] = writer.register_schema(one.name, one.encoding, one.data)
            elif isinstance(one, Channel):
                if one.id not in channels:
                    channels[one.id] = writer.register_channel(
                        one.topic, one.message_encoding, schemas.get(one.schema_id, 0), one.metadata
                    )
            elif isinstance(one, Message):
                if one.channel_id in channels:
                    writer.add_message(
                        channels[one.channel_id], one.log_time, one.data, one.publish_time,
                        one.sequence,
                    )  # fmt: skip
            elif isinstance(one, Metadata):
                writer.add_metadata(one.name, one.metadata)
            elif isinstance(one, Attachment):
                writer.add_attachment(
                    one.create_time, one.log_time, one.name, one.media_type, one.data
                )
        writer.finish()
