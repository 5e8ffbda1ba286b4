"""What schemathesis cannot know by itself: content that the studio takes, and content that is no JSON."""

import io
import zipfile

import schemathesis
from hypothesis import strategies as st


def a_zip() -> bytes:
    """An archive that is well formed and holds no session."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("take-01/take.toml", 'object = "sphere_50mm"\n')
    return content.getvalue()


schemathesis.openapi.media_type("application/zip", st.sampled_from([a_zip(), b"", b"PK\x03\x04"]))
schemathesis.openapi.media_type("application/toml", st.sampled_from([b"", b"x = ", b'[[fault]]\nkind = "none"\n']))


@schemathesis.serializer("application/zip", "application/toml")
def as_bytes(_ctx, value):
    """Sends bytes as they are."""
    return value if isinstance(value, bytes) else str(value).encode()


@schemathesis.deserializer(
    "application/x-protobuf", "application/jsonl", "application/toml", "application/octet-stream", "text/html"
)
def as_text(_ctx, response):
    """Takes what is no JSON for a text."""
    return response.content.decode("utf-8", "replace")


# What the test has put into the studio, by the name of the path's parameter.
KNOWN = {"session": "bench", "take": "take-01", "run": "run-1", "job": "run-1", "model": "kept", "file": "report.json"}


@schemathesis.hook
def map_path_parameters(context, path_parameters):
    """Asks for things that are there in most cases; what is deleted is something else."""
    if not path_parameters or context.operation.method.upper() == "DELETE":
        return path_parameters
    is_known = sum(map(len, map(str, path_parameters.values()))) % 4 != 3
    return {name: KNOWN.get(name, value) if is_known else value for name, value in path_parameters.items()}
