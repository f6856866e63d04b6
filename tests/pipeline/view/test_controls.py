"""The viewer driven as a user drives it: by clicks and keys, from a file, without a network."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page
from viewed import opened, viewed_model, viewed_scene, write_page


@pytest.fixture(scope="module")
def address(tmp_path_factory) -> str:
    return write_page(tmp_path_factory.mktemp("viewer") / "viewer.html", viewed_scene(), viewed_model("full"))


@pytest.fixture(scope="module")
def page(browser: Browser, address: str) -> Iterator[Page]:
    with opened(browser, address, (800, 300)) as page:
        page.context.set_offline(True)
        yield page


@pytest.fixture(autouse=True)
def as_opened(page: Page) -> None:
    """Paused at the first time in the free view; the tests share the page, which takes seconds to open."""
    page.evaluate("""() => {
        viewer.state.set({ playing: false, speed: 1, time: 0, compare: "render", colourBy: "colour" });
        viewer.state.set({ background: null });
        document.getElementById("help").close();
        document.getElementById("reset").click();
        document.activeElement.blur();
    }""")


def state(page: Page, name: str):
    return page.evaluate("name => viewer.state[name]", name)


def shown(page: Page) -> np.ndarray:
    """(H, W, 3) of the first canvas, once the picture is finished."""
    script = """async () => {
        await viewer.stage.settled();
        const { canvas } = viewer.stage.panes[0].renderer, copy = new OffscreenCanvas(canvas.width, canvas.height);
        copy.getContext("2d").drawImage(canvas, 0, 0);
        const { data } = copy.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        let text = "";
        for (let i = 0; i < data.length; i += 4096) text += String.fromCharCode(...data.subarray(i, i + 4096));
        return [canvas.width, canvas.height, btoa(text)];
    }"""
    width, height, text = page.evaluate(script)
    return np.frombuffer(base64.b64decode(text), np.uint8).reshape(height, width, 4)[..., :3].astype(float)


def go_to(page: Page, time: float) -> None:
    """The slider, moved to a time."""
    script = "(slider, time) => { slider.value = time; slider.dispatchEvent(new Event('input')); }"
    page.locator("#time").evaluate(script, time)


def compare(page: Page, how: str) -> None:
    page.click(f"#compare [data-compare={how}]")


def test_it_plays_by_itself(browser: Browser, address: str) -> None:
    with opened(browser, address, (320, 300)) as fresh:
        fresh.wait_for_function("viewer.state.time > 0.02")
        assert fresh.evaluate("viewer.state.playing")


def test_play_and_pause(page: Page) -> None:
    for act in (lambda: page.click("#play"), lambda: page.keyboard.press(" ")):
        act()
        assert state(page, "playing")
        page.wait_for_function("viewer.state.time > 0")
        act()
        assert not state(page, "playing")


def test_slider_and_steps(page: Page) -> None:
    box = page.locator("#time").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert state(page, "time") == pytest.approx(0.5, abs=0.01) and "0.5" in page.locator("#clock").inner_text()
    go_to(page, 0.5)
    page.click("#step-on")
    assert state(page, "time") == pytest.approx(0.7)  # six training times: a fifth of the duration apart
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    assert state(page, "time") == pytest.approx(0.3)
    before = shown(page)
    page.keyboard.press("ArrowRight")
    assert np.abs(shown(page) - before).max() > 20  # another time, another picture


def test_speed(page: Page) -> None:
    page.select_option("#speed", "0.25")
    page.keyboard.press("ArrowUp")
    assert state(page, "speed") == 0.5


def test_dragging_orbits_and_reset_returns(page: Page) -> None:
    before = state(page, "pose")
    box = page.locator("#stage canvas").first.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 80, y + 10, steps=3)
    page.mouse.up()
    after = state(page, "pose")
    # About the origin: as far from it as before, somewhere else.
    assert np.linalg.norm(after["position"]) == pytest.approx(np.linalg.norm(before["position"]))
    assert np.linalg.norm(np.subtract(after["position"], before["position"])) > 0.5
    turned = np.array([after["right"], after["down"], after["forward"]])
    assert turned @ turned.T == pytest.approx(np.eye(3), abs=1e-9)
    page.mouse.wheel(0, -400)
    page.wait_for_function(
        "d => Math.hypot(...viewer.state.pose.position) < d", arg=np.linalg.norm(before["position"]) - 0.3
    )
    page.keyboard.press("r")
    assert state(page, "pose") == before


def test_keys_fly(page: Page) -> None:
    forward, position = (np.array(state(page, "pose")[name]) for name in ("forward", "position"))
    page.keyboard.down("w")
    page.wait_for_function(
        "p => Math.hypot(...viewer.state.pose.position.map((x, i) => x - p[i])) > 0.02", arg=position.tolist()
    )
    page.keyboard.up("w")
    moved = np.array(state(page, "pose")["position"]) - position
    assert moved / np.linalg.norm(moved) == pytest.approx(forward, abs=1e-6)


def test_a_camera_of_the_data_has_its_pixels_and_its_truth(page: Page) -> None:
    scene = viewed_scene()
    page.select_option("#camera", label="test/r_2")
    assert state(page, "time") == pytest.approx(scene.test[1].time)
    render = shown(page)
    assert render.shape == scene.test[1].image.shape
    compare(page, "truth")
    # WebP of quality 90 keeps a ramp to a few levels.
    assert np.abs(shown(page) - scene.test[1].image).mean() < 3
    truth = shown(page)
    compare(page, "difference")
    assert np.abs(shown(page) - np.minimum(255, 4 * np.abs(render - truth))).mean() < 2
    compare(page, "wipe")
    half = shown(page)
    assert np.abs(half[:, 62:] - truth[:, 62:]).max() == 0 and np.abs(half[:, :58] - render[:, :58]).max() == 0
    compare(page, "beside")
    assert page.locator("figure.truth canvas").is_visible() and np.abs(shown(page) - render).max() == 0
    page.click("#camera-after")
    assert page.locator("#camera option:checked").inner_text() == "test/r_4"


def test_truth_is_one_click_away_from_a_free_view(page: Page) -> None:
    go_to(page, 0.41)
    compare(page, "truth")
    camera = viewer_camera(page)
    assert camera["name"] in ("test/r_0", "test/r_2", "train/r_0", "train/r_2") and state(page, "compare") == "truth"
    page.keyboard.press("t")
    assert state(page, "compare") == "wipe" and page.locator("#wipe").is_visible()


def viewer_camera(page: Page) -> dict:
    return page.evaluate("viewer.scene.cameras[viewer.state.camera]")


def test_colours_and_background(page: Page) -> None:
    seen = [shown(page)]
    for colours in ("lifetime", "speed", "depth"):
        page.keyboard.press("c")
        assert state(page, "colourBy") == colours and page.locator("#colour-by").input_value() == colours
        seen.append(shown(page))
        page.wait_for_selector("#legend:visible")
    for i, one in enumerate(seen):
        assert all(np.abs(one - other).mean() > 2 for other in seen[:i])
    page.keyboard.press("c")
    page.locator("#background").fill("#00ff00")
    assert shown(page)[0, 0].tolist() == [0, 255, 0]  # no Gaussian in the corner
    page.click("#background-reset")
    assert np.abs(shown(page) - seen[0]).max() == 0


def test_a_link_holds_time_and_view(page: Page, browser: Browser, address: str) -> None:
    go_to(page, 0.6)
    box = page.locator("#stage canvas").first.bounding_box()
    page.mouse.move(box["x"] + 90, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 140, box["y"] + 180)
    page.mouse.up()
    page.keyboard.press("c")
    page.keyboard.press("l")
    link = page.evaluate("location.hash")
    with opened(browser, address + link, (800, 300)) as other:
        assert state(other, "colourBy") == "lifetime" and not state(other, "playing")
        assert np.abs(shown(other) - shown(page)).max() <= 2  # poses are written with five digits
    with opened(browser, address + "#camera=nobody&time=x&pose=1,2&compare=all", (300, 300)) as other:
        assert state(other, "camera") is None  # what is not understood is left out


def test_help_lists_the_keys(page: Page) -> None:
    page.keyboard.press("?")
    listed = page.locator("#help dl").inner_text()
    assert page.locator("#help").is_visible() and "play or pause" in listed and "W A S D" in listed
    page.click("#help button")
    assert page.locator("#help").is_hidden()


def test_screenshot_is_the_picture(page: Page, tmp_path: Path) -> None:
    from PIL import Image

    page.select_option("#camera", label="test/r_0")
    wanted = shown(page)
    with page.expect_download() as download:
        page.keyboard.press("p")
    download.value.save_as(tmp_path / "shot.png")
    assert download.value.suggested_filename == "dnerf_model-0_0.000.png"
    assert np.abs(np.asarray(Image.open(tmp_path / "shot.png").convert("RGB")) - wanted).max() == 0


def test_numbers(page: Page) -> None:
    page.click("#play")
    page.wait_for_function("document.getElementById('numbers').innerText.includes('alive')")
    assert "300" in page.locator("#numbers").inner_text()


def test_touch_and_phone_width(browser: Browser, address: str) -> None:
    with opened(browser, address, (360, 640), has_touch=True) as phone:
        assert not phone.locator("#panel").is_visible() and phone.locator("[data-compare=truth]").is_visible()
        phone.click("#panel-button")
        assert phone.locator("#camera").is_visible()
        assert phone.evaluate("document.documentElement.scrollWidth") <= 360
        phone.click("#panel-button")
        before = state(phone, "pose")["position"]
        session = phone.context.new_cdp_session(phone)
        for kind, points in (
            ("touchStart", [(100, 300), (160, 300)]),
            ("touchMove", [(80, 300), (200, 300)]),
            ("touchEnd", []),
        ):
            touches = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
            session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})
        phone.wait_for_function("d => Math.hypot(...viewer.state.pose.position) < d", arg=0.9 * np.linalg.norm(before))


def test_memory_does_not_grow_over_500_frames(browser: Browser, address: str) -> None:
    with opened(browser, address, (200, 180)) as page:
        session = page.context.new_cdp_session(page)
        session.send("HeapProfiler.enable")

        def after_playing(frames: int) -> float:
            page.evaluate("viewer.state.set({ playing: true, speed: 4 })")
            last = page.evaluate("viewer.stage.frames") + frames
            page.wait_for_function("last => viewer.stage.frames >= last", arg=last, timeout=60_000)
            page.evaluate("viewer.state.set({ playing: false })")
            session.send("HeapProfiler.collectGarbage")
            return session.send("Runtime.getHeapUsage")["usedSize"] / 1e6

        before = after_playing(50)
        assert after_playing(500) < before + 0.2  # MB; a forgotten array of a frame's order alone would add 2
