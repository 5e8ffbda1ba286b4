"""Opens a take with the stock MCAP reader: no code of ours, only what the file says about itself.

    pip install mcap mcap-protobuf-support
    python read_take.py TAKE.mcap

Decodes every message and prints one JSON document: counts, times and one message per topic, schema names,
attachments, metadata. Exits with an error if a message does not decode or the statistics do not match.
"""

import json
import sys

from google.protobuf.json_format import MessageToDict
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def main(path: str) -> dict:
    topics: dict[str, dict] = {}
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        header = reader.get_header()
        summary = reader.get_summary()
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            topic = topics.setdefault(
                channel.topic,
                {
                    "schema": schema.name,
                    "encoding": schema.encoding,
                    "messages": 0,
                    "first_log_time_ns": message.log_time,
                    "about": dict(channel.metadata),
                    "first_message": MessageToDict(decoded, preserving_proto_field_name=True),
                },
            )
            assert decoded.DESCRIPTOR.full_name == schema.name, (decoded.DESCRIPTOR.full_name, schema.name)
            topic["messages"] += 1
            topic["last_log_time_ns"] = message.log_time
        attachments = [
            {"name": attachment.name, "media_type": attachment.media_type, "size": len(attachment.data)}
            for attachment in reader.iter_attachments()
        ]
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}

    decoded_count = sum(topic["messages"] for topic in topics.values())
    assert summary.statistics.message_count == decoded_count, (summary.statistics.message_count, decoded_count)
    return {
        "library": header.library,
        "topics": topics,
        "attachments": attachments,
        "metadata": metadata,
        "chunks": len(summary.chunk_indexes),
    }


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python read_take.py TAKE.mcap")
    json.dump(main(sys.argv[1]), sys.stdout, indent=2, sort_keys=True)
    print()
