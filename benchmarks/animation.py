"""The README's moving picture: policies side by side under the machining force.

Each picture is what ``render_mode="rgb_array"`` draws; the orange trace is the tip error, 25 times as large.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from pathlib import Path

import gymnasium as gym
import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from fuzzyarm import load_policy
from fuzzyarm.envs._pictures import FOOTER, HEADER
from fuzzyarm.eval.episodes.loop import episodes

SIZE, TITLE, COLOURS = 300, 44, 48  # px, px, palette entries: below 1 MB
FRAME, LAST = 40, 1500  # ms for which a picture and the last one are shown: 1.5 s of motion in 4 s
STEPS = 15  # control steps between pictures


def gif(policies: Sequence[str]) -> bytes:
    """Return the pictures of some policies as GIF."""
    pictures, content = [Image.fromarray(frame) for frame in frames(policies)], io.BytesIO()
    palette = pictures[-1].quantize(COLOURS)
    first, *others = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    shown = [FRAME] * len(others) + [LAST]
    first.save(content, "GIF", save_all=True, append_images=others, duration=shown, loop=0, optimize=True)
    return content.getvalue()


def frames(policies: Sequence[str]) -> Iterator[np.ndarray]:
    """Yield the pictures of the policies side by side, (height, width, 3)."""
    episodes = [episode(name) for name in policies]
    for pictures in zip(*episodes, strict=True):
        yield np.hstack(pictures)


def episode(name: str) -> Iterator[np.ndarray]:
    """Yield the pictures of one policy, with its name and tip error above."""
    env = gym.make("fuzzyarm:FuzzyArm-v0", case="machining", render_mode="rgb_array")
    observation, info = env.reset(seed=0)
    yield _titled(env.render(), name, 1e3 * info["tip_error"], worst := 0.0)
    for count, step in enumerate(episodes(env, load_policy(name), (observation, info)), start=1):
        error = 1e3 * step.info["tip_error"]
        worst = max(worst, error)
        if count % STEPS == 0 or step.ended:
            yield _titled(env.render(), name, error, worst)


def _titled(picture: np.ndarray, name: str, error: float, worst: float) -> np.ndarray:
    """Return the field of a picture, scaled, below a title; errors in mm."""
    field = Image.fromarray(picture[HEADER + 2 : -FOOTER - 2])
    height = round(SIZE * field.height / field.width)
    canvas = Image.new("RGB", (SIZE, TITLE + height), "white")
    canvas.paste(field.resize((SIZE, height), Image.Resampling.LANCZOS), (0, TITLE))
    draw = ImageDraw.Draw(canvas)
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    draw.text((12, 6), name, "#26323e", ImageFont.truetype(fonts / "DejaVuSans-Bold.ttf", 14))
    small = ImageFont.truetype(fonts / "DejaVuSans.ttf", 12)
    draw.text((12, 25), f"tip error {error:.1f} mm, so far at most {worst:.1f} mm", "#d55e00", small)
    return np.asarray(canvas)
