"""A page in headless Chromium, by the WebDriver protocol: what it draws, what goes wrong, what it does when used."""

from __future__ import annotations

import contextlib
import http.client
import json
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

DRIVER = shutil.which("chromedriver")
OPTIONS = [
    *("--headless=new", "--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-sync"),
    *("--disable-component-update", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    "--disable-gpu-rasterization",  # which Debian's Chromium has on; in software it takes longer
]
SECONDS = 120.0

# In the page: every fold that has some of these plots is opened in turn, and scrolled past.
USE = """const [which, done] = arguments;
(async () => {
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
const frame = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done, 20)));
const all = [...document.querySelectorAll(which)];
const blank = [];
for (const plot of all) {
  for (let fold = plot.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
  plot.scrollIntoView();
  for (let n = 0; n < 100 && !plot.querySelector(".main-svg, canvas"); n += 1) await frame();
  const drawn = plot.querySelector(".main-svg, canvas") && plot.data?.length;
  if (!drawn) blank.push(plot.getAttribute("aria-label") || "?");
}
const found = { plots: all.length, blank };
const root = document.documentElement;
found.wide = root.scrollWidth > root.clientWidth;
found.background = getComputedStyle(document.body).backgroundColor;
return found;
})().then(done, (error) => done({ wrong: [String(error)] }));"""


# Where the identified robot's plot is, what it draws, and from where all of the robot's plots are looked at.
ROBOT = """const plot = document.querySelector("[data-robot=found]"), box = plot.getBoundingClientRect();
return {
  x: Math.round(box.left + box.width / 2), y: Math.round(box.top + box.height / 2),
  eye: plot._fullLayout.scene._scene.getCamera().eye,
  eyes: [...document.querySelectorAll("[data-robot]")].map((each) => each._fullLayout.scene._scene.getCamera().eye),
  places: plot.data.map((trace) => trace.z.filter((z) => z !== null).slice(0, 400)),
};"""
LOOK = """document.querySelector("[data-robot]").scrollIntoView({ block: "center" });"""
MOVE = """const slider = document.getElementById("posture");
slider.value = arguments[0]; slider.dispatchEvent(new Event("input"));"""


class Browser:
    """A running one."""

    def __init__(self, port: int) -> None:
        self._port, self._session = port, ""
        chrome = {"goog:chromeOptions": {"args": OPTIONS}, "goog:loggingPrefs": {"browser": "ALL"}}
        started = self._ask("/session", {"capabilities": {"alwaysMatch": chrome}})
        self._session = f"/session/{started['sessionId']}"
        self._ask("/timeouts", {"script": int(1000 * SECONDS)})

    def _ask(self, what: str, data: Any) -> Any:
        return self._answer("POST", what, json.dumps(data))

    def _answer(self, method: str, what: str, body: str | None = None) -> Any:
        connection = http.client.HTTPConnection("127.0.0.1", self._port, timeout=SECONDS)
        with contextlib.closing(connection):
            connection.request(method, self._session + what, body)
            return json.load(connection.getresponse())["value"]

    def _set(self, what: str, **values: Any) -> None:
        self._ask("/goog/cdp/execute", {"cmd": f"Emulation.{what}", "params": values})

    def use(self, page: Path, width: int, dark: bool, plots: str = ".plot") -> dict[str, Any]:
        """Open a page, so many pixels wide, and use it, all of it or some plots by their selector: figures by name."""
        self._set("setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=width < 600)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._set("setEmulatedMedia", features=[scheme])
        self._ask("/url", {"url": page.as_uri()})
        found = self._ask("/execute/async", {"script": USE, "args": [plots]})
        assert isinstance(found, dict)
        found["dark"] = sum(map(int, re.findall(r"\d+", found["background"])[:3])) < 3 * 128
        found["wrong"] = [
            line["message"] for line in self._ask("/se/log", {"type": "browser"}) if line["level"] == "SEVERE"
        ]
        return found

    def run(self, script: str, *arguments: Any) -> Any:
        """What a script in the page returns, half a second later."""
        found = self._ask("/execute/sync", {"script": script, "args": list(arguments)})
        time.sleep(0.5)
        return found

    def drag(self, x: int, y: int, by: int) -> None:
        """Press the mouse, move it to the right, and let go."""
        to = [{"type": "pointerMove", "duration": 50, "x": x + by * k // 4, "y": y} for k in range(1, 5)]
        first: list[dict[str, Any]] = [{"type": "pointerMove", "x": x, "y": y}, {"type": "pointerDown", "button": 0}]
        actions = [*first, *to, {"type": "pointerUp", "button": 0}]
        mouse = {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": actions}
        self._ask("/actions", {"actions": [mouse]})
        time.sleep(0.5)

    def close(self) -> None:
        """End it."""
        self._answer("DELETE", "")


@contextlib.contextmanager
def browser() -> Iterator[Browser]:
    """A browser that is ended in the end."""
    assert DRIVER is not None
    with subprocess.Popen([DRIVER, "--port=0"], stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout is not None
        started = next(found for line in driver.stdout if (found := re.search(r"successfully on port (\d+)", line)))
        try:
            one = Browser(int(started[1]))
            try:
                yield one
            finally:
                one.close()
        finally:
            driver.terminate()
