"""What a real browser makes of a page: Chromium without a window, driven by a script that the page is given."""

import json
import re
import subprocess
from pathlib import Path
from typing import Any

from chromium import CHROMIUM


def answers(page: str, script: str, folder: Path, *, width: int = 1200) -> Any:
    """Return what `script` finds in the page: the value that its function body returns, once the page is drawn."""
    asked = (
        "<script>addEventListener('load', () => setTimeout(() => {"
        f"const found = (() => {{{script}}})();"
        "const place = document.createElement('pre'); place.id = 'found';"
        "place.textContent = JSON.stringify(found); document.body.replaceChildren(place);"
        "}, 50));</script></body>"
    )
    path = folder / "page.html"
    path.write_text(page.replace("</body>", asked), encoding="utf-8")
    assert CHROMIUM is not None
    command = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
        f"--user-data-dir={folder / 'profile'}", f"--window-size={width},900", "--virtual-time-budget=3000",
        "--dump-dom", path.as_uri(),
    ]  # fmt: skip
    dom = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    (found,) = re.findall(r'<pre id="found">(.*?)</pre>', dom, flags=re.DOTALL)
    return json.loads(found.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))
