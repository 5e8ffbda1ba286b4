"""A studio where everybody logs in, over TLS with a certificate of its own."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import until

from palpate import Palpate, PalpateError
from palpate.control import stop

TRUTH = "small"


class Locked:
    """Its address, the file of its certificate, and how to make tokens."""

    def __init__(self, binary: Path, data: Path, url: str) -> None:
        self.binary, self.data, self.url = binary, data, url
        self.ca_file = data / "tls" / "cert.pem"

    def token(self, person: str) -> str:
        made = self.run("tokens", "create", person, "--name", "test")
        assert made.startswith("plp_")
        return made

    def run(self, *arguments: str, password: str | None = None) -> str:
        command: list[str | Path] = [self.binary, *arguments, "--data", self.data]
        return subprocess.run(command, input=password, check=True, capture_output=True, text=True).stdout.strip()


@pytest.fixture(scope="module")
def locked(binary: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Locked]:
    data = tmp_path_factory.mktemp("locked")
    studio = Locked(binary, data, "")
    for person, role in (("root", "admin"), ("olga", "operator"), ("vera", "viewer")):
        studio.run("people", "add", person, "--role", role, password="correct horse battery\n")
    command: list[str | Path] = [binary, "serve", "--listen", "127.0.0.1:0", "--json", "--data", data]
    command += ["--login", "--tls", "--emulate", TRUTH]
    with (data / "studio.log").open("w") as log:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        assert process.stdout is not None
        try:
            studio.url = json.loads(process.stdout.readline())["url"]
            yield studio
        finally:
            process.terminate()
            process.wait(timeout=30)


def test_a_certificate_that_is_not_known_is_not_trusted(locked: Locked, tmp_path: Path) -> None:
    assert locked.url.startswith("https://")
    with pytest.raises(PalpateError, match=r"not trusted.*tls/cert\.pem.*ca_file"), Palpate(locked.url, "plp_0"):
        pass
    with pytest.raises(PalpateError, match="failed to read certificates"):
        Palpate(locked.url, ca_file=tmp_path / "none.pem")


def test_without_a_token_nobody_gets_in(locked: Locked) -> None:
    for token in (None, "plp_" + "0" * 64):
        with pytest.raises(PalpateError) as caught, Palpate(locked.url, token, ca_file=locked.ca_file):
            pass
        assert caught.value.status == 401
    with pytest.raises(PalpateError) as caught:
        next(iter(Palpate(locked.url, ca_file=locked.ca_file).stream()))
    assert caught.value.status == 401


def test_a_viewer_watches_and_may_stop_but_not_operate(locked: Locked) -> None:
    with Palpate(locked.url, locked.token("vera"), ca_file=locked.ca_file) as p:
        assert next(iter(p.stream())).joints
        with pytest.raises(PalpateError, match="role of operator"), p.control("vera"):
            pass
        with pytest.raises(PalpateError) as caught:
            p.connection.request("POST", "/calibrations", body={"session": "x"})
        assert caught.value.status == 403
        stop(p.connection)
        until("stopped", lambda: p.live().phase == "stopped")


def test_an_operator_has_control_over_tls_under_their_own_name(locked: Locked) -> None:
    with Palpate(locked.url, locked.token("olga"), ca_file=locked.ca_file) as p:
        with p.control("somebody else"):
            until("held by olga", lambda: p.live().holder == "olga")
        token = json.loads(locked.run("tokens", "list", "--json"))[-1]
        locked.run("tokens", "revoke", str(token["id"]))
        with pytest.raises(PalpateError):
            for _ in p.stream():
                pass
        with pytest.raises(PalpateError) as caught:
            p.info()
        assert caught.value.status == 401
