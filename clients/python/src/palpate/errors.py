"""The one error that this package raises for what a studio, or the way to it, says no to."""

from __future__ import annotations


class PalpateError(Exception):
    """A request that failed.

    Attributes:
        title: Short summary of the kind of error.
        detail: What happened, where, and what to do.
        status: HTTP status of the answer; None where there was none.
        type: URI of the kind of error, which never changes, e.g. `urn:palpate:problem:not-found`; empty where the
            studio gave none. `docs/api.md` lists them.

    """

    def __init__(self, title: str, detail: str = "", status: int | None = None, type: str = "") -> None:
        super().__init__(f"{title}: {detail}" if detail else title)
        self.title = title
        self.detail = detail
        self.status = status
        self.type = type
