"""Draws floor plans of some homes of a set, galleries of them, and maps as they were read, as PNG and SVG."""

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from mrtask.analysis.drawing.floor_plans import draw_gallery, draw_home, draw_scan
from mrtask.homes.home import SIZE_CLASSES, Home
from mrtask.maps.home_map import HomeMap
from mrtask.names import counted
from pipeline.base import console
from pipeline.base.specs import MapOptions
from pipeline.store.folder import Folder
from pipeline.store.home_files import HomeFiles, MapFiles, distinct_layouts

DRAWN_PER_CLASS = 4
GALLERY = "gallery"


def draw(source: HomeFiles, title: str, maps: MapOptions, target: Folder) -> None:
    """Draw some homes of each size class, a gallery of them called ``title`` and, if they come from maps, these."""
    began_s = time.monotonic()
    mapped = _examples(source, maps)
    console.headline("drawing", counted(len(mapped), "home"))
    with console.Progress(len(mapped), "homes") as progress, tempfile.TemporaryDirectory() as temporary:
        for home, home_map in mapped:
            figure = Figure(figsize=(8, 8), layout="constrained")
            draw_home(home, home_map, figure.subplots())
            _save(figure, Path(temporary), f"{home.size_class}-{home.id}", dpi=150)
            progress.update()
        _save(draw_gallery({title: mapped}), Path(temporary), GALLERY, dpi=100)
        for scan in source.scans() if isinstance(source, MapFiles) else ():
            figure = Figure(figsize=(8, 8), layout="constrained")
            draw_scan(scan, figure.subplots())
            _save(figure, Path(temporary), f"scan-{Path(scan.home.source).stem}", dpi=150)
        target.upload(Path(temporary))
    if isinstance(source, MapFiles):
        for home, home_map in mapped:
            if out_of_reach := home_map.out_of_reach(home):
                console.line(f"warning: {home.source}: {out_of_reach}")
    console.result(target, time.monotonic() - began_s)


def draw_side_by_side(sources: Mapping[str, HomeFiles], maps: MapOptions, target: Folder) -> None:
    """Draw one gallery with a column of homes for each source, under its title."""
    with tempfile.TemporaryDirectory() as temporary:
        columns = {title: _examples(source, maps) for title, source in sources.items()}
        _save(draw_gallery(columns), Path(temporary), GALLERY, dpi=100)
        target.upload(Path(temporary))
    console.line(f"-> {target / GALLERY}.png")


def _examples(source: HomeFiles, maps: MapOptions) -> Sequence[tuple[Home, HomeMap]]:
    """Return the first few homes of each size class, each of another layout, with their maps."""
    layouts = distinct_layouts(source.read())
    chosen = [home for name in SIZE_CLASSES for home in [h for h in layouts if h.size_class == name][:DRAWN_PER_CLASS]]
    return [(home, maps.map_of(home)) for home in chosen]


def _save(figure: Figure, folder: Path, name: str, dpi: int) -> None:
    for kind in ("png", "svg"):
        figure.savefig(folder / f"{name}.{kind}", dpi=dpi)
