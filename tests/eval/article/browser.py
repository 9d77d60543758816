"""A page in headless Chromium: what it logs and how it is laid out."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)

_PROBE = """
<script>
window.addEventListener("load", () => {
  const wide = [...document.querySelectorAll("body *")].filter((element) => {
    const box = element.getBoundingClientRect();
    return !element.closest("svg, details:not([open])") && box.right > window.innerWidth + 1;
  });
  const drawn = [...document.querySelectorAll("figure svg")].map((svg) => {
    const box = svg.getBoundingClientRect();
    return [box.width, box.height];
  });
  const facts = {
    inner: window.innerWidth, scroll: document.scrollingElement.scrollWidth,
    wide: wide.map((element) => element.outerHTML.slice(0, 120)), drawn: drawn,
  };
  window.parent.postMessage(JSON.stringify(facts), "*");
});
</script>
"""

# a window has a least width of its own, a frame in it has none
_FRAME = """<!doctype html><body style="margin:0">
<iframe src="{source}" style="border:0;width:{width}px;height:3000px"></iframe>
<script>
window.addEventListener("message", (event) => {{
  const out = document.createElement("pre");
  out.id = "facts";
  out.textContent = event.data;
  document.body.append(out);
}});
</script>
"""


class Page(NamedTuple):
    facts: dict[str, Any]
    """`inner` and `scroll` widths, elements that are too `wide`, sizes of figures `drawn`."""
    console: list[str]


def open_page(path: Path, width: int, folder: Path) -> Page:
    """Open an HTML file at a window width of so many pixels, without a network."""
    probed = folder / f"probed-{width}.html"
    probed.write_text(path.read_text(encoding="utf-8").replace("</head>", _PROBE + "</head>"))
    frame = folder / f"frame-{width}.html"
    frame.write_text(_FRAME.format(source=probed.as_uri(), width=width))
    command = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
        "--no-first-run", "--disable-background-networking", "--disable-component-update",
        "--disable-sync", "--enable-logging=stderr", "--v=0", "--allow-file-access-from-files",
        f"--user-data-dir={folder / 'profile'}", f"--window-size={max(width, 600)},3000",
        "--virtual-time-budget=5000", "--dump-dom",
    ]  # fmt: skip
    done = subprocess.run([*command, frame.as_uri()], capture_output=True, text=True, timeout=120)
    found = re.search(r'<pre id="facts">(.*?)</pre>', done.stdout, re.S)
    assert found, done.stderr[-2000:]
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    text = found.group(1).replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
    return Page(json.loads(text), console)
