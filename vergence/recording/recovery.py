"""Recovery of a log that a crash has truncated."""

import os
from typing import Any, cast

from vergence.recording.records import read_records


def recover_log(path: str | os.PathLike[str], out: str | os.PathLike[str]) -> None:
    """Copy all readable records of an MCAP file to a new, complete one, with an index and an end.

    Args:
        path: the truncated file.
        out: the new file.

    Raises:
        UnreadableFileError: the file is no MCAP file.
        OSError: the new file cannot be written.
    """
    from mcap.records import Attachment, Channel, Message, Metadata, Schema
    from mcap.writer import Writer

    schemas: dict[int, tuple[Schema, int]] = {}
    channels: dict[int, tuple[Channel, int]] = {}
    with open(out, "xb") as file:
        writer = cast(Any, Writer(file))  # some of its methods have no types
        writer.start()
        for one in read_records(path):
            if isinstance(one, Schema):
                if one.id not in schemas or schemas[one.id][0] != one:  # a file's end repeats them
                    number = writer.register_schema(one.name, one.encoding, one.data)
                    schemas[one.id] = one, number
            elif isinstance(one, Channel):
                if one.id not in channels or channels[one.id][0] != one:
                    _, known = schemas.get(one.schema_id, (None, 0))
                    number = writer.register_channel(
                        one.topic, one.message_encoding, known, one.metadata
                    )
                    channels[one.id] = one, number
            elif isinstance(one, Message):
                if one.channel_id in channels:
                    number = channels[one.channel_id][1]
                    writer.add_message(
                        number, one.log_time, one.data, one.publish_time, one.sequence
                    )
            elif isinstance(one, Metadata):
                writer.add_metadata(one.name, one.metadata)
            elif isinstance(one, Attachment):
                writer.add_attachment(
                    one.create_time, one.log_time, one.name, one.media_type, one.data
                )
        writer.finish()
