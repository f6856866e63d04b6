"""The live view: what it tells whom, that it changes nothing of training, and the page while a run is trained."""

from __future__ import annotations

import http.client
import json
import socket
import struct
import threading
import zlib
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser
from tiny import TinyRun, fake_evaluate, tiny_config, tiny_scene
from viewed import opened, viewed_model, viewed_scene

from pipeline.model.initialise import initialise
from pipeline.training.loop import train
from pipeline.training.reporting import Progress, StepReport
from pipeline.view.live.feed import Feed, TrainingView
from pipeline.view.live.server import Address, LiveServer, address_of
from pipeline.view.pack import pack
from pipeline.view.viewer import live_page

ANY_PORT = Address("127.0.0.1", 0)


@pytest.fixture()
def server():
    with LiveServer(ANY_PORT, "<p>the page", Feed()) as server:
        yield server


def get(server: LiveServer, path: str = "/", **headers: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.address.port, timeout=20)
    connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
    answer = connection.getresponse()
    return answer.status, answer.read()


def test_only_its_own_page_may_read(server: LiveServer) -> None:
    own, port = f"http://127.0.0.1:{server.address.port}", server.address.port
    assert get(server) == (200, b"<p>the page")
    assert get(server, Origin=own)[0] == 200
    assert get(server, Host=f"localhost:{port}", Origin=f"http://localhost:{port}")[0] == 200
    assert get(server, Sec_Fetch_Site="cross-site", Sec_Fetch_Mode="navigate")[0] == 200  # a link to it was clicked
    for refused in (
        {"Host": "evil.example"},  # a name that was made to point here
        {"Host": f"evil.example:{port}"},
        {"Host": "127.0.0.1:1"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},  # a sandboxed frame, or a file
        {"Origin": f"https://127.0.0.1:{port}"},
        {"Host": f"localhost:{port}", "Origin": own},
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors"},
        {"Sec_Fetch_Site": "same-site", "Sec_Fetch_Mode": "cors"},
    ):
        for path in ("/", "/model", "/events"):
            status, text = get(server, path, **refused)
            assert status == 403 and b"expected" in text and b"page" not in text, refused


def test_it_answers_nothing_else(server: LiveServer) -> None:
    assert get(server, "/../etc/passwd")[0] == 404
    connection = http.client.HTTPConnection("127.0.0.1", server.address.port, timeout=20)
    connection.request("POST", "/model", b"x")
    assert connection.getresponse().status == 501


def test_it_listens_on_this_machine_only(server: LiveServer) -> None:
    assert server.address.host == "127.0.0.1"
    others = {found[4][0] for found in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {"127.0.0.1"}
    for address in others:
        if not address.startswith("127."):
            with pytest.raises(OSError):
                socket.create_connection((address, server.address.port), timeout=2)


def test_the_next_free_port_is_taken(server: LiveServer) -> None:
    with LiveServer(server.address, "", Feed()) as second:
        assert second.address.port > server.address.port


@pytest.mark.parametrize("text", ["8080", "127.0.0.1", "127.0.0.1:", ":80", "a:99999", "a:-1", "a:٣"])
def test_an_address_is_host_and_port(text: str) -> None:
    with pytest.raises(ValueError, match="view_at: expected HOST:PORT such as 127.0.0.1:8080, found"):
        address_of(text, "view_at")


def test_a_foreign_address_is_named() -> None:
    with pytest.raises(OSError, match="198.51.100.1:80: expected an address of this machine"):
        LiveServer(Address("198.51.100.1", 80), "", Feed())


def test_a_model_is_packed_only_when_a_page_waits(server: LiveServer) -> None:
    model, view = viewed_model("full", count=20), TrainingView(server.feed, viewed_scene(), 100)
    view.step(model, StepReport(10, 1.0, 0.5, 20.0, 20, 20.0))
    assert server.feed.model_after(-1, 0) is None  # nobody had asked; now somebody has
    view.step(model, StepReport(20, 1.0, 0.4, 21.0, 20, 20.0))
    status, message = get(server, "/model?after=-1")
    assert status == 200
    length = int.from_bytes(message[:4], "little")
    header = json.loads(message[4 : 4 + length])
    assert (header["iteration"], header["trained"]) == (20, 20)
    assert zlib.decompress(message[4 + length :]) == zlib.decompress(pack(model, viewed_scene()).data)
    server.feed.model_after(20, 0)
    view.step(model, StepReport(30, 1.0, 0.3, 22.0, 20, 20.0))  # sooner than SECONDS: not yet
    assert server.feed.model_after(20, 0) is None
    server.feed.end()
    assert get(server, "/model?after=20") == (204, b"")


def test_events_tell_of_progress(server: LiveServer) -> None:
    view = TrainingView(server.feed, viewed_scene(), 100)
    view.evaluated(viewed_model("full", count=20), Progress(5, 1.0), {"psnr": 19.5})
    view.step(viewed_model("full", count=20), StepReport(10, 1.0, 0.5, 20.0, 20, 20.0))
    server.feed.end()
    text = get(server, "/events")[1].decode()
    assert text.startswith("event: progress\ndata: ") and text.endswith("event: end\ndata: {}\n\n")
    told = json.loads(text.splitlines()[1].removeprefix("data: "))
    assert told == {
        "iteration": 10, "iterations": 100, "loss": 0.5, "psnr": 20.0, "held_out": 19.5, "n_gaussians": 20,
    }  # fmt: skip


def trained(path: Path, view: TrainingView | None) -> dict:
    cfg, scene = tiny_config(), tiny_scene()
    model = initialise(scene, cfg, np.random.default_rng(0))
    return train(model, scene, cfg, TinyRun(path), fake_evaluate, observers=[view] if view else []).model.parameters


def test_training_is_the_same_to_the_bit(tmp_path: Path) -> None:
    feed = Feed()
    stop = threading.Event()

    def ask() -> None:
        while not stop.is_set():
            feed.model_after(10**9, 0.01)

    asking = threading.Thread(target=ask)
    asking.start()
    seen = trained(tmp_path / "seen", TrainingView(feed, tiny_scene(), 60))
    stop.set()
    asking.join()
    assert feed.model_after(-1, 0) is not None
    alone = trained(tmp_path / "alone", None)
    assert all((seen[name] == alone[name]).all() for name in alone)


def test_the_page_follows_training(browser: Browser) -> None:
    scene, feed = viewed_scene(), Feed()
    view = TrainingView(feed, scene, 300)
    stop = threading.Event()

    def train_slowly() -> None:
        for iteration in range(10, 10_000, 10):
            if stop.wait(0.05):
                return
            view._next = 0.0  # a test does not wait SECONDS
            view.step(viewed_model("full", count=40), StepReport(iteration, 1.0, 1 / iteration, 20.0, 20, 20.0))

    with LiveServer(ANY_PORT, live_page("full", scene, tiny_config()), feed) as server:
        training = threading.Thread(target=train_slowly)
        training.start()
        try:
            with opened(browser, server.url, (800, 700)) as page:
                first = page.evaluate("viewer.stage.panes[0].model.header.iteration")
                page.wait_for_function("n => viewer.stage.panes[0].model.header.iteration > n", arg=first)
                page.wait_for_function("document.getElementById('training').innerText.includes('20.00 dB')")
                assert "of 300" in page.locator("#training").inner_text()
                stop.set()
                feed.end()
                page.wait_for_selector("#training.ended")
        finally:
            stop.set()
            training.join()


def test_a_page_that_goes_away_prints_nothing(server: LiveServer, capfd: pytest.CaptureFixture) -> None:
    with socket.create_connection(("127.0.0.1", server.address.port)) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # it is reset, not closed
        connection.send(b"GET / HT")
    assert get(server)[0] == 200
    assert get(server)[0] == 200  # each in a thread: the first one has ended
    assert capfd.readouterr().err == ""


def test_a_run_of_another_process_is_followed(tmp_path: Path) -> None:
    from pipeline.view.live.followed_run import LogTail

    log = tmp_path / "log.jsonl"
    tail = LogTail(log, 100)
    assert tail.newest() is None
    row = {"event": "train", "iteration": 100, "loss": 0.1, "psnr": 21.0, "n_gaussians": 5}
    log.write_text(json.dumps({"event": "evaluate", "psnr": 19.0}) + "\n" + json.dumps(row) + "\n" + '{"event": "tr')
    found = tail.newest()
    assert found == {"iteration": 100, "iterations": 100, "loss": 0.1, "psnr": 21.0, "n_gaussians": 5, "held_out": 19.0}
    assert tail.newest() is None  # the last line is not whole yet
    with open(log, "a") as file:
        file.write('ain", "iteration": 200, "loss": 0.1, "psnr": 22.0, "n_gaussians": 5}\nnot json\n')
    assert tail.newest() == {**found, "iteration": 200, "psnr": 22.0}


def test_a_run_that_begins_anew_is_seen(server: LiveServer) -> None:
    packed = pack(viewed_model("full", count=20), viewed_scene())
    server.feed.offer(5000, packed)
    server.feed.report({"iteration": 5000})
    assert server.feed.model_after(5000, 0) is None and server.feed.progress_after(5000, 0) is None
    server.feed.offer(0, packed)
    server.feed.report({"iteration": 10})
    assert server.feed.model_after(5000, 0) is not None and server.feed.progress_after(5000, 0) == {"iteration": 10}


def test_another_address_of_this_machine_serves_its_page() -> None:
    with LiveServer(Address("127.0.0.2", 0), "page", Feed()) as other:
        connection = http.client.HTTPConnection("127.0.0.2", other.address.port, timeout=20)
        connection.request("GET", "/")
        response = connection.getresponse()
        assert (response.status, response.read()) == (200, b"page")
        connection.close()
