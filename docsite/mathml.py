"""Equations as MathML, made when the site is built: to read them takes no script and no font."""

from __future__ import annotations

import html
import re

from latex2mathml.converter import convert

BLOCK = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.DOTALL)
INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
TAG = re.compile(r"\\tag\{([^{}]*)\}")


def equations(page: str) -> str:
    r"""Replace what arithmatex marked as TeX by MathML.

    Parameters
    ----------
    page : str
        HTML of a page. ``\tag{14}`` in a block is the equation's number.

    Raises
    ------
    ValueError
        TeX that was not understood.
    """
    page = BLOCK.sub(_block, page)
    return INLINE.sub(lambda found: _math(found[1], "inline"), page)


def _block(found: re.Match[str]) -> str:
    tex = found[1]
    tags = TAG.findall(tex)
    number = f'<span class="number">({tags[0]})</span>' if tags else ""
    return f'<div class="equation">{_math(TAG.sub("", tex), "block")}{number}</div>'


def _math(tex: str, display: str) -> str:
    tex = html.unescape(tex).strip()
    made: str = convert(tex, display=display)
    # What it does not know it passes on as text.
    if "\\" in html.unescape(made) or ">&<" in made:
        raise ValueError(f"TeX that is not understood: {tex}")
    return made
