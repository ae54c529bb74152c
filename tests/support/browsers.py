"""A real browser without a window, for pages on disk; tests skip where there is none."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
# What a page may ask for: itself, and what it holds.
LOCAL = ("file:", "data:", "blob:")


def browser_in(folder: Path) -> Any:
    """A browser whose profile is in `folder`, with its console and its requests on record."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    from selenium.webdriver.chrome.service import Service

    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    driver = shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("chromium and chromedriver are not installed")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in (*FLAGS, f"--user-data-dir={folder / 'profile'}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    return webdriver.Chrome(options=options, service=Service(driver))


def resize(browser: Any, width: int, height: int) -> None:
    """Show the page as on a screen of that size."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def prefer(browser: Any, scheme: str) -> None:
    """Show the page as to someone who prefers ``"light"`` or ``"dark"``."""
    feature = {"name": "prefers-color-scheme", "value": scheme}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})


def console_errors(browser: Any) -> list[str]:
    """What the console has called an error since it was last asked."""
    return [x["message"] for x in browser.get_log("browser") if x["level"] == "SEVERE"]


def requests_out(browser: Any) -> list[str]:
    """Addresses outside the page that it asked for since it was last asked."""
    events = [json.loads(x["message"])["message"] for x in browser.get_log("performance")]
    asked = [x["params"] for x in events if x["method"] == "Network.requestWillBeSent"]
    # A browser begins with a page of its own.
    from_disk = [x for x in asked if x["documentURL"].startswith("file:")]
    urls = [str(x["request"]["url"]) for x in from_disk]
    return [x for x in urls if not x.startswith(LOCAL)]
