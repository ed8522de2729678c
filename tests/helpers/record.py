"""The moving picture of the front page, a recording of the live page: `make live`, then this script."""

import base64
import io
import tempfile
from pathlib import Path

from browser import opened
from PIL import Image

from railrepro import paths

SIZE, SCALE, SHOWN = (1180, 900), 0.62, ("nmpc", "ndi", "ndi_integral")
CHOOSE = f"""(async () => {{
  const done = () => (document.body?.innerText ?? '').split('End of the track').length > 2;
  while (!done()) await new Promise(then => setTimeout(then, 50));
  document.querySelectorAll('#controllers input').forEach(box => box.checked = {list(SHOWN)}.includes(box.value));
  const figure = document.getElementById('figure');
  figure.value = 'braking', document.getElementById('controllers').dispatchEvent(new Event('change'));
  figure.dispatchEvent(new Event('change'));
}})()"""
DRIVING = "document.getElementById('scores').innerText.includes('driving')"


def frames(page) -> list[Image.Image]:
    """Pictures of a run, as many as the browser gives."""
    page.evaluated(CHOOSE)
    while not page.evaluated(DRIVING):
        pass
    found = []
    while page.evaluated(DRIVING):
        shot = io.BytesIO(base64.b64decode(page.ask("Page.captureScreenshot", format="png")["data"]))
        picture = Image.open(shot).convert("RGB")
        found.append(picture.resize([round(SCALE * side) for side in picture.size], Image.Resampling.LANCZOS))
    return found


if __name__ == "__main__":
    file, url = paths.ROOT / "figures/live.gif", (paths.BUILD / "live/index.html").as_uri()
    with tempfile.TemporaryDirectory() as folder, opened(url, Path(folder), ",".join(map(str, SIZE))) as live:
        pictures = frames(live)[::2]
    taken = [picture.quantize(64, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE) for picture in pictures]
    times = [120] * (len(taken) - 1) + [4000]
    taken[0].save(file, save_all=True, append_images=taken[1:], duration=times, loop=0, optimize=True)
    print(f"{file.name}: {len(taken)} pictures, {file.stat().st_size / 1e3:.0f} kB")
