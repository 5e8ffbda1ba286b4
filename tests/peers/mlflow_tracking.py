"""MLflow's tracking server doing what `palpate bench api` asks of a studio: make runs, log metrics, list, look up.

Starts `mlflow server` on SQLite in a folder of its own, as a lab would on one computer, and talks to its REST API over
connections that stay open. Prints one JSON document: p50, p99 and the longest of each kind of request, ms. Nothing else loads the
server meanwhile: no page watches it.
"""

import argparse
import contextlib
import json
import socket
import subprocess
import sys
import tempfile
import threading
import time

import requests

parser = argparse.ArgumentParser()
parser.add_argument("--runs", type=int, default=1000)
parser.add_argument("--seconds", type=float, default=30)
parser.add_argument("--clients", type=int, default=4)
args = parser.parse_args()


def quantile(values, share):
    ordered = sorted(values)
    return ordered[round(share * (len(ordered) - 1))] if ordered else 0.0


def delays(seconds):
    ms = [1e3 * value for value in seconds]
    return {"requests": len(ms), "p50": quantile(ms, 0.5), "p99": quantile(ms, 0.99), "max": max(ms, default=0.0)}


with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
api = f"http://127.0.0.1:{port}/api/2.0/mlflow"


def ask(session, method, path, **what):
    begun = time.perf_counter()
    answer = session.request(method, f"{api}/{path}", timeout=60, **what)
    body = answer.content
    seconds = time.perf_counter() - begun
    answer.raise_for_status()
    return json.loads(body), seconds


with tempfile.TemporaryDirectory() as folder:
    server = subprocess.Popen(
        [sys.executable, "-m", "mlflow", "server", "--host", "127.0.0.1", "--port", str(port)]
        + ["--backend-store-uri", f"sqlite:///{folder}/mlflow.db", "--artifacts-destination", f"{folder}/artifacts"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        session = requests.Session()
        for _ in range(600):
            with contextlib.suppress(requests.RequestException):
                if session.get(f"http://127.0.0.1:{port}/health", timeout=5).ok:
                    break
            if server.poll() is not None:
                sys.exit(f"mlflow server ended with code {server.returncode}")
            time.sleep(0.2)
        else:
            sys.exit("mlflow server was not ready after two minutes")
        experiment = ask(session, "POST", "experiments/create", json={"name": "bench"})[0]["experiment_id"]
        ids, created, logged = [], [], []
        for number in range(args.runs):
            run = {"experiment_id": experiment, "run_name": f"run-{number}", "start_time": int(1e3 * time.time())}
            answer, seconds = ask(session, "POST", "runs/create", json=run)
            created.append(seconds)
            ids.append(answer["run"]["info"]["run_id"])
        for step in range(1000):
            point = {"run_id": ids[0], "key": "loss", "value": 1.0 / (step + 1), "timestamp": step, "step": step}
            logged.append(ask(session, "POST", "runs/log-metric", json=point)[1])
        until = time.monotonic() + args.seconds
        listed, got, read, problems = [], [], [], []

        def look(first):
            mine = requests.Session()
            number = first
            try:
                while time.monotonic() < until:
                    search = {"experiment_ids": [experiment], "max_results": 100}
                    listed.append(ask(mine, "POST", "runs/search", json=search)[1])
                    run_id = ids[number % min(100, len(ids))]
                    got.append(ask(mine, "GET", "runs/get", params={"run_id": run_id})[1])
                    history = {"run_id": run_id, "metric_key": "loss"}
                    read.append(ask(mine, "GET", "metrics/get-history", params=history)[1])
                    number += 1
                    time.sleep(0.02)
            except requests.RequestException as error:
                problems.append(str(error))

        clients = [threading.Thread(target=look, args=(number,)) for number in range(args.clients)]
        for client in clients:
            client.start()
        for client in clients:
            client.join()
        if problems:
            sys.exit(f"a request failed: {problems[0]}")
    finally:
        server.terminate()
        server.wait()

print(
    json.dumps(
        {
            "create": delays(created),
            "list": delays(listed),
            "get": delays(got),
            "log_metric": delays(logged),
            "read_metrics": delays(read),
        }
    )
)
