"""Formulas between dollars as MathML, which browsers draw by themselves: no script, nothing fetched."""

import html
import re

from latex2mathml.converter import convert

_FORMULA = re.compile(r"\$\$(.+?)\$\$|(?<![\\$\w`])\$([^$`]+?)\$(?!\w)", re.S)


def set_aside(markdown: str) -> tuple[str, list[str]]:
    """The text with a token for each formula, and the formulas as MathML."""
    made: list[str] = []

    def token(formula: re.Match[str]) -> str:
        display = formula[1] is not None
        made.append(convert(html.unescape(formula[1] or formula[2]), display="block" if display else "inline"))
        return f"MATHML{len(made) - 1}END"

    return _FORMULA.sub(token, markdown), made


def put_back(page: str, made: list[str]) -> str:
    """The page with the formulas in the place of their tokens."""
    return re.sub(r"MATHML(\d+)END", lambda token: made[int(token[1])], page)
