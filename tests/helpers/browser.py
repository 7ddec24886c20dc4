"""A browser without a screen and without a network, and the replay that it shows."""

from __future__ import annotations

import io
import shutil
import time

import numpy as np
import pytest
from PIL import Image

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
CHROMEDRIVER = shutil.which("chromedriver")
_missing = pytest.mark.skipif(
    not CHROMIUM or not CHROMEDRIVER, reason="no browser: apt-get install chromium chromium-driver"
)


def needs_browser(test):
    """Marks a test as one of a browser's; it is skipped where there is none."""
    return pytest.mark.browser(_missing(test))


def browser(profile):
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in (
        "--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
        "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage", f"--user-data-dir={profile}",
        "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--window-size=420,620",
        "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    ):  # fmt: skip
        options.add_argument(argument)
    return webdriver.Chrome(options=options, service=Service(CHROMEDRIVER))


def seen_at(driver, seconds):
    """(height, width, 3) the scene at a time, once it stands still."""
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.ui import WebDriverWait

    field = WebDriverWait(driver, 60).until(lambda d: d.find_element(By.CSS_SELECTOR, "input[inputmode]"))
    for _ in range(10):
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(seconds, Keys.TAB)
        # While it plays, the page writes into the field, too; the first key stops it.
        if float(field.get_attribute("value")) == float(seconds):
            break
    assert float(field.get_attribute("value")) == float(seconds)
    driver.execute_script(
        "document.querySelectorAll('.mantine-Notifications-root').forEach(e => e.style.display = 'none')"
    )
    before = None
    for _ in range(40):
        time.sleep(0.4)
        canvas = WebDriverWait(driver, 60).until(lambda d: d.find_element(By.TAG_NAME, "canvas"))
        now = np.asarray(Image.open(io.BytesIO(canvas.screenshot_as_png)).convert("RGB"))
        if before is not None and now.shape == before.shape and now.std() > 3 and np.array_equal(now, before):
            return now
        before = now
    raise AssertionError("the scene does not come to rest")
