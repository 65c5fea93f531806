"""The widget in a real JupyterLab in Chromium: a picture comes, follows the pointer, and the kernel
knows of it.

    python -m benchmarks.service widget [--width 480] [--height 360]

Starts `isogi serve` with the built-in demo and JupyterLab beside it, opens a notebook that shows a
``Viewer``, runs its cell, waits for the picture, drags it, and asks the kernel for the azimuth.
"""

import json
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import httpx
from playwright.sync_api import Page, sync_playwright

from benchmarks.common.measurement import Measurement
from benchmarks.common.serving import serving
from benchmarks.common.suite import part
from benchmarks.service.browser import CHROMIUM

PICTURE = ".isogi img"
SHOWN = f"document.querySelector('{PICTURE}')?.naturalWidth > 0"
PATIENCE = 240.0
"""Seconds for JupyterLab, its kernel and the first picture, on a machine that others use too."""

DRAG = 100
"""Pixels that the pointer goes."""

CELLS = (
    'from isogi.client import Isogi\nfrom isogi.widget import Viewer\n\nisogi = Isogi("{url}")\n'
    'viewer = Viewer(isogi, isogi.scenes()[0]["id"], width={width}, height={height})\nviewer',
    'print("azimuth is", viewer.azimuth)',
)


def notebook(folder: Path, **given: Any) -> str:
    """The name of a notebook with the CELLS, of which the first shows a viewer."""
    cell: dict[str, Any] = {
        "cell_type": "code",
        "metadata": {},
        "outputs": [],
        "execution_count": None,
    }
    cells = [
        {**cell, "id": f"cell-{n}", "source": text.format(**given)} for n, text in enumerate(CELLS)
    ]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    document = {
        "cells": cells,
        "metadata": {"kernelspec": kernel},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    (folder / "viewer.ipynb").write_text(json.dumps(document), encoding="utf-8")
    return "viewer.ipynb"


@contextmanager
def laboratory(folder: Path) -> Iterator[str]:
    """The address of a JupyterLab that shows a folder. Raises ClickException where it does not
    start.
    """
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    given = [
        "--no-browser",
        "--allow-root",
        f"--ServerApp.port={port}",
        f"--ServerApp.root_dir={folder}",
    ]
    given += ["--IdentityProvider.token=", "--LabApp.news_url=None"]
    command = [sys.executable, "-m", "jupyterlab", *given]
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(command, stdout=quiet, stderr=quiet)
    try:
        await_answer(f"http://127.0.0.1:{port}/api", process)
        yield f"http://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait(30)


def await_answer(url: str, process: "subprocess.Popen[bytes]") -> None:
    """Returns once a server answers. Raises ClickException where it ends, or does not."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end and process.poll() is None:
        try:
            if httpx.get(url).status_code == 200:
                return
        except httpx.TransportError:
            time.sleep(0.2)
    raise click.ClickException("JupyterLab does not start: pip install jupyterlab anywidget.")


def visit(page: Page, address: str) -> tuple[dict[str, Any], bytes]:
    """Run the notebook's cells, drag the picture, and what came of it; and how the page looks."""
    page.goto(address)
    begun = time.monotonic()
    page.locator(".jp-CodeCell .cm-content").first.click(timeout=1000 * PATIENCE)
    page.keyboard.press("Shift+Enter")
    page.wait_for_function(SHOWN, timeout=1000 * PATIENCE)
    figures: dict[str, Any] = {"picture after, s": time.monotonic() - begun}
    size = page.eval_on_selector(PICTURE, "image => [image.naturalWidth, image.naturalHeight]")
    source = page.get_attribute(PICTURE, "src")
    box = page.locator(PICTURE).bounding_box()
    assert box is not None, "the picture is on the page"
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 2 - DRAG, box["y"] + box["height"] / 2, steps=5)
    page.mouse.up()
    dragged = time.monotonic()
    page.wait_for_function(
        f"document.querySelector('{PICTURE}').src !== '{source}'", timeout=1000 * PATIENCE
    )
    figures |= {"another picture after a drag, s": time.monotonic() - dragged}
    page.locator(".jp-CodeCell .cm-content").nth(1).click()
    page.keyboard.press("Shift+Enter")
    told = page.locator(".jp-OutputArea-output pre", has_text="azimuth is").inner_text(
        timeout=1000 * PATIENCE
    )
    page.wait_for_timeout(3000)
    return figures | {
        "picture": " × ".join(map(str, size)),
        "the kernel's azimuth": told.split()[-1],
    }, page.screenshot()


@part()
@click.option("--width", default=480, show_default=True, help="Pixels of the picture.")
@click.option("--height", default=360, show_default=True, help="Pixels of the picture.")
def widget(width: int, height: int) -> Measurement:
    """The widget in a real JupyterLab: a picture, a drag, and what the kernel knows of it."""
    with (
        tempfile.TemporaryDirectory() as name,
        serving("demo:casting", f"{name}/light", workers=1) as server,
    ):
        folder = Path(name, "notebooks")
        folder.mkdir()
        file = notebook(folder, url=server.url, width=width, height=height)
        with laboratory(folder) as url, sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"]
            )
            page = browser.new_page(viewport={"width": 1100, "height": 800})
            figures, shot = visit(page, f"{url}/lab/tree/{file}")
            browser.close()
    title = "The widget in JupyterLab"
    found = Measurement(title, figures)
    text = f"{found.body}\n\n![JupyterLab with the widget](service-widget/jupyterlab.png)"
    return Measurement(title, figures, text, {"jupyterlab.png": shot})
