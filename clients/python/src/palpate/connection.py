"""HTTP requests and WebSocket connections to a studio: address, token, lease, retries, errors."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import re
import ssl
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote, unquote, urlsplit

import httpx
import websockets.exceptions
from websockets.sync.client import ClientConnection, connect

from palpate.errors import PalpateError

LEASE_HEADER = "Palpate-Lease"
MAX_TRIES = 6
"""A GET that the studio is too busy for is sent at most so often."""
MAX_WAIT_S = 60.0
"""A Retry-After beyond this is not waited for, s."""
ARCHIVE_TIMEOUT_S = 600.0
"""A studio may pack a long session for so long before the first byte comes, s."""
CLOSE_S = 1.0
"""A studio that does not say goodbye is not waited for any longer, s."""
_OPEN: set[ClientConnection] = set()


@atexit.register
def _close_all() -> None:
    """Closes what is open still, such as the connection of a stream that nobody read to its end.

    Later, when Python takes itself apart, threads stand still and closing would wait for them for ever.
    """
    for connection in list(_OPEN):
        connection.close()


class Connection:
    """Sends requests to one studio. Paths are below `/api/v1`, with parameters in braces as the server writes them."""

    def __init__(
        self,
        url: str,
        token: str | None = None,
        *,
        ca_file: str | Path | None = None,
        timeout_s: float = 60.0,
        transport: httpx.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.url = (url if "://" in url else f"http://{url}").rstrip("/")
        parts = urlsplit(self.url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise PalpateError("Not an address", f"{url!r}; expected something like http://127.0.0.1:8080")
        self.lease = 0
        self._headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._sleep = sleep
        self._timeout_s = timeout_s
        # A studio on this computer is never reached through a proxy, whatever the environment says.
        self._is_local = parts.hostname in ("localhost", "::1") or parts.hostname.startswith("127.")
        self._ssl = _trust(ca_file) if parts.scheme == "https" else None
        self._client = httpx.Client(
            base_url=f"{self.url}/api/v1",
            headers=self._headers,
            timeout=httpx.Timeout(timeout_s, connect=10.0),
            transport=transport,
            verify=self._ssl or True,
            trust_env=not self._is_local,
        )

    def close(self) -> None:
        """Closes all HTTP connections."""
        self._client.close()

    def request(
        self,
        method: str,
        path: str,
        *,
        params: Mapping[str, str | None] | None = None,
        body: object = None,
        content: IO[bytes] | str | None = None,
        content_type: str | None = None,
        headers: Mapping[str, str] | None = None,
        as_operator: bool = False,
        timeout_s: float | None = None,
        **ids: str,
    ) -> httpx.Response:
        """Sends a request and gives the answer, or raises PalpateError.

        `body` is sent as JSON, `content` as it is. With `as_operator` the lease that this client holds goes along. A
        GET that is answered by 429 or 503 is repeated when the studio says that it may be.
        """
        sent = dict(headers or {})
        if content_type:
            sent["Content-Type"] = content_type
        if as_operator and self.lease:
            sent[LEASE_HEADER] = str(self.lease)
        query = {name: value for name, value in (params or {}).items() if value is not None}
        request = self._client.build_request(
            method,
            fill(path, ids),
            params=query,
            json=body,
            content=content,
            headers=sent,
            timeout=httpx.USE_CLIENT_DEFAULT if timeout_s is None else httpx.Timeout(timeout_s, connect=10.0),
        )
        tries = MAX_TRIES if method == "GET" else 1
        for attempt in range(1, tries + 1):
            try:
                response = self._client.send(request)
            except httpx.RemoteProtocolError as error:
                # A kept connection that the studio closed just now; a GET does no harm when it is sent again.
                if attempt == tries:
                    raise self._unreachable(error) from error
                continue
            except httpx.TransportError as error:
                raise self._unreachable(error) from error
            wait_s = retry_after_s(response, attempt)
            if response.status_code not in (429, 503) or attempt == tries or wait_s > MAX_WAIT_S:
                break
            self._sleep(wait_s)
        if response.is_error:
            raise problem(response.status_code, response.reason_phrase, response.content)
        return response

    def download(self, method: str, path: str, to: str | os.PathLike[str], **ids: str) -> Path:
        """Writes the answer to the file `to` as it comes in, and gives its path.

        A folder gets a file of the name that the studio says. On an error nothing is left, and a file of that name is
        as it was. `method` is GET: it names the route.
        """
        assert method == "GET"
        try:
            timeout = httpx.Timeout(ARCHIVE_TIMEOUT_S, connect=10.0)
            with self._client.stream(method, fill(path, ids), timeout=timeout) as response:
                if response.is_error:
                    raise problem(response.status_code, response.reason_phrase, response.read())
                target = Path(to)
                if target.is_dir():
                    target /= _file_name(response)
                part = target.with_name(f".{target.name}.part")
                try:
                    with part.open("wb") as file:
                        for piece in response.iter_bytes():
                            file.write(piece)
                    part.replace(target)
                except OSError as error:
                    raise PalpateError("Not written", f"failed to write {str(target)!r}: {error.strerror}") from error
                finally:
                    part.unlink(missing_ok=True)
        except httpx.TransportError as error:
            raise self._unreachable(error) from error
        return target

    def json(self, method: str, path: str, **arguments: Any) -> Any:  # noqa: ANN401
        """`request` for an answer in JSON; None where the answer is empty."""
        response = self.request(method, path, **arguments)
        if not response.content:
            return None
        try:
            return response.json()
        except ValueError as error:
            raise PalpateError("No studio", f"{self.url} answers, but not in JSON: is it a Palpate studio?") from error

    @contextlib.contextmanager
    def socket(self, method: str, path: str, *, max_queue: int) -> Iterator[ClientConnection]:
        """A WebSocket connection, closed at the end of the block. `method` is GET: it names the route.

        At most `max_queue` messages wait here for a reader that is slow; more wait at the studio, which drops old ones.
        """
        assert method == "GET"
        url = f"ws{self.url.removeprefix('http')}/api/v1{path}"
        try:
            connection = connect(
                url,
                additional_headers=self._headers,
                ssl=self._ssl,
                compression=None,
                max_size=None,
                max_queue=max_queue,
                close_timeout=CLOSE_S,
                proxy=None if self._is_local else True,
            )
        except websockets.exceptions.InvalidStatus as error:
            answer = error.response
            raise problem(answer.status_code, answer.reason_phrase, bytes(answer.body or b"")) from error
        except (OSError, websockets.exceptions.WebSocketException) as error:
            raise self._unreachable(error) from error
        _OPEN.add(connection)
        try:
            with connection:
                yield connection
        finally:
            _OPEN.discard(connection)

    def _unreachable(self, error: Exception) -> PalpateError:
        if "CERTIFICATE_VERIFY_FAILED" in str(error):
            return PalpateError(
                "Unknown certificate",
                f"{self.url} shows a certificate that is not trusted ({error}); if it is the studio's own, say where "
                "a copy of its tls/cert.pem is: Palpate(url, ca_file=...), or the environment variable PALPATE_CA_FILE",
            )
        if isinstance(error, httpx.TimeoutException) and not isinstance(error, httpx.ConnectTimeout):
            return PalpateError("Timeout", f"{self.url} did not answer within {self._timeout_s:g} s")
        return PalpateError(
            "No studio",
            f"nothing answers at {self.url} ({error}); start a studio with `palpate serve`, or `cargo xtask studio` in "
            "the checkout, or say where it is: Palpate(url), or the environment variable PALPATE_URL",
        )


def _trust(ca_file: str | Path | None) -> ssl.SSLContext:
    """What is trusted: certificates of the system, and those in `ca_file`, e.g. a studio's own."""
    context = ssl.create_default_context()
    if ca_file is not None:
        try:
            context.load_verify_locations(cafile=ca_file)
        except (OSError, ssl.SSLError) as error:
            raise PalpateError(
                "No certificate", f"failed to read certificates in PEM from {str(ca_file)!r}: {error}"
            ) from error
    return context


def _file_name(response: httpx.Response) -> str:
    """The plain name of the file that an answer is to be kept as."""
    _, _, name = response.headers.get("Content-Disposition", "").partition("filename*=UTF-8''")
    return Path(unquote(name)).name or "download"


def fill(path: str, ids: Mapping[str, str]) -> str:
    """`path` with each `{name}` replaced by the id of that name, percent-encoded."""
    return re.sub(r"\{(\w+)\}", lambda match: quote(ids[match[1]], safe=""), path)


def retry_after_s(response: httpx.Response, attempt: int) -> float:
    """What the header Retry-After asks for, s; without one, longer with every attempt."""
    try:
        return max(0.0, float(response.headers["Retry-After"]))
    except (KeyError, ValueError):
        return float(0.5 * 2 ** (attempt - 1))


def problem(status: int, reason: str, body: bytes) -> PalpateError:
    """The error of an answer: RFC 9457 problem details, or else its text."""
    try:
        document = json.loads(body)
        title, detail, kind = str(document["title"]), str(document["detail"]), str(document.get("type", ""))
    except (ValueError, KeyError, TypeError, AttributeError):
        title, detail, kind = reason or "Error", body.decode(errors="replace").strip()[:300], ""
    return PalpateError(title, detail, status, kind)
