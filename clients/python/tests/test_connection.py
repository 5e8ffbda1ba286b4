"""Requests, retries and errors against a server that is made up."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from palpate import Palpate, PalpateError
from palpate.connection import MAX_TRIES, Connection, fill

INFO = {"name": "palpate", "version": "0.1.0", "station": None, "source": "replay", "insecure": False}


def connection(answer: Callable[[httpx.Request], httpx.Response], slept: list[float] | None = None) -> Connection:
    sleep = (slept if slept is not None else []).append
    return Connection("http://127.0.0.1:8080", "secret", transport=httpx.MockTransport(answer), sleep=sleep)


def problem(status: int, detail: str, **headers: str) -> httpx.Response:
    document = {"type": "urn:palpate:problem:some", "title": "Some title", "status": status, "detail": detail}
    return httpx.Response(status, json=document, headers=headers)


def test_a_problem_becomes_an_error_with_title_detail_and_status() -> None:
    with pytest.raises(PalpateError) as caught:
        connection(lambda _: problem(404, 'no session "x"')).json("GET", "/sessions/{session}", session="x")
    error = caught.value
    assert (error.title, error.detail, error.status, error.type) == (
        "Some title",
        'no session "x"',
        404,
        "urn:palpate:problem:some",
    )
    assert str(error) == 'Some title: no session "x"'


def test_an_answer_that_is_no_problem_document_is_shown_as_it_is() -> None:
    with pytest.raises(PalpateError, match="Bad Gateway: <h1>proxy</h1>"):
        connection(lambda _: httpx.Response(502, text="<h1>proxy</h1>")).json("GET", "/info")


@pytest.mark.parametrize("status", [429, 503])
def test_a_busy_studio_is_asked_again_when_it_says_so(status: int) -> None:
    slept: list[float] = []
    answers = iter(
        [problem(status, "busy", **{"Retry-After": "3"}), problem(status, "busy"), httpx.Response(200, json=[])]
    )
    assert connection(lambda _: next(answers), slept).json("GET", "/sessions") == []
    assert slept == [3.0, 1.0]


def test_a_studio_that_stays_busy_is_given_up() -> None:
    slept: list[float] = []
    with pytest.raises(PalpateError) as caught:
        connection(lambda _: problem(503, "busy", **{"Retry-After": "1"}), slept).json("GET", "/sessions")
    assert caught.value.status == 503
    assert len(slept) == MAX_TRIES - 1


def test_what_changes_something_is_never_sent_twice() -> None:
    sent: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        sent.append(request.method)
        return problem(503, "busy", **{"Retry-After": "1"})

    with pytest.raises(PalpateError):
        connection(answer).json("POST", "/calibrations", body={})
    assert sent == ["POST"]


def test_a_long_pause_is_left_to_the_caller() -> None:
    slept: list[float] = []
    with pytest.raises(PalpateError, match="busy"):
        connection(lambda _: problem(503, "busy", **{"Retry-After": "3600"}), slept).json("GET", "/sessions")
    assert slept == []


def test_a_kept_connection_that_was_closed_is_opened_again() -> None:
    calls: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        calls.append(request.url.path)
        if len(calls) == 1:
            raise httpx.RemoteProtocolError("Server disconnected without sending a response.")
        return httpx.Response(200, json=[])

    assert connection(answer).json("GET", "/sessions") == []
    assert calls == ["/api/v1/sessions"] * 2


def test_a_studio_that_is_not_there_is_explained() -> None:
    def answer(_: httpx.Request) -> httpx.Response:
        raise httpx.ConnectError("Connection refused")

    with pytest.raises(PalpateError, match=r"nothing answers at http://127.0.0.1:8080.*palpate serve.*PALPATE_URL"):
        connection(answer).json("GET", "/info")


def test_a_server_of_something_else_is_told_from_a_studio() -> None:
    with pytest.raises(PalpateError, match="not in JSON"):
        connection(lambda _: httpx.Response(200, text="<html>")).json("GET", "/info")
    other = httpx.MockTransport(lambda _: httpx.Response(200, json={**INFO, "name": "jupyter"}))
    with pytest.raises(PalpateError, match="'jupyter', not a Palpate studio"), Palpate(transport=other):
        pass
    unlike = httpx.MockTransport(lambda _: httpx.Response(200, json={"name": "palpate"}))
    with pytest.raises(PalpateError, match="are studio and client of one version"):
        Palpate(transport=unlike).info()


def test_no_address_is_refused() -> None:
    for url in ("ftp://studio", "http://", "//"):
        with pytest.raises(PalpateError, match="expected something like"):
            Palpate(url)


def test_token_and_lease_go_where_they_belong() -> None:
    seen: list[httpx.Request] = []

    def answer(request: httpx.Request) -> httpx.Response:
        seen.append(request)
        return httpx.Response(200, json={})

    to = connection(answer)
    to.lease = 7
    to.request("GET", "/sessions")
    to.request("POST", "/recording/act", body={"action": "run"}, as_operator=True)
    assert [request.headers["Authorization"] for request in seen] == ["Bearer secret"] * 2
    assert "Palpate-Lease" not in seen[0].headers
    assert seen[1].headers["Palpate-Lease"] == "7"


def test_the_environment_says_where_the_studio_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PALPATE_URL", "https://lab.example:8443/")
    monkeypatch.setenv("PALPATE_TOKEN", "t")
    with httpx.Client():
        assert Palpate().connection.url == "https://lab.example:8443"
    assert Palpate("10.0.0.7:80").connection.url == "http://10.0.0.7:80"
    monkeypatch.delenv("PALPATE_URL")
    assert Palpate().connection.url == "http://127.0.0.1:8080"


def test_ids_are_encoded_in_paths() -> None:
    assert fill("/sessions/{session}/takes/{take}/trace", {"session": "a/b c", "take": "1"}) == (
        "/sessions/a%2Fb%20c/takes/1/trace"
    )


def test_uploading_nothing_is_explained(tmp_path: Path) -> None:
    studio = Palpate(transport=httpx.MockTransport(lambda _: httpx.Response(200, json={})))
    with pytest.raises(PalpateError, match="failed to read"):
        studio.upload(tmp_path / "nowhere.zip")
