"""The picture of the README from the previews of a case: ``python -m bench.picture CASE_DIR docs/images/cup_c.png``."""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

HEIGHT = 420


def main(case: Path, target: Path) -> None:
    preview = case / "preview"
    views = sorted(preview.glob("projection_*.png"))
    panels = [
        Image.open(preview / "phantom.png"),
        Image.open(preview / "compressed.png"),
        breast_only(Image.open(views[len(views) // 2])),
        breast_only(Image.open(preview / "volume.png")),
    ]
    scaled = [
        p.convert("L").resize((round(p.width * HEIGHT / p.height), HEIGHT), Image.Resampling.LANCZOS) for p in panels
    ]
    sheet = Image.new("L", (sum(p.width for p in scaled) + 8 * (len(scaled) - 1), HEIGHT), 255)
    x = 0
    for p in scaled:
        sheet.paste(p, (x, 0))
        x += p.width + 8
    target.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(target, optimize=True)


def breast_only(image: Image.Image) -> Image.Image:
    """Cut to what is not black, with a small margin."""
    box = image.convert("L").point(lambda v: 255 if v > 8 else 0).getbbox() or (0, 0, *image.size)
    return image.crop((0, max(0, box[1] - 10), min(image.width, box[2] + 10), min(image.height, box[3] + 10)))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
