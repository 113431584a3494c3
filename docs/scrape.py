"""Pictures of an example for the gallery: those of pyplot, and every new Figure that a function returned."""

from typing import Any

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

from hallsym.report.drawing import STYLE


def style(settings: dict[str, Any], name: str) -> None:
    """Begin an example in the style of hallsym's own pictures, whose margins hold for its fonts."""
    plt.close("all")
    plt.rcdefaults()
    plt.rcParams.update(STYLE)


def figures(block: Any, variables: dict[str, Any], settings: dict[str, Any]) -> str:
    """Save each figure among the variables of the block and return the text that shows them."""
    done = variables.setdefault("scraped", set())
    shown = [f for f in variables["example_globals"].values() if isinstance(f, Figure) and id(f) not in done]
    done.update(map(id, shown))
    paths = []
    for figure, path in zip(shown, variables["image_path_iterator"], strict=False):
        figure.savefig(path, dpi=200)
        paths.append(path)
    plt.close("all")
    return figure_rst(paths, settings["src_dir"])
