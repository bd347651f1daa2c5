"""Plots beside one another on a page, each with its words below."""

from html import escape


def figures(*captioned: tuple[str, str]) -> str:
    """(caption, SVG) each, as figures."""
    return "".join(f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>" for caption, svg in captioned)
