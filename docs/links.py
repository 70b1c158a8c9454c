"""Check every internal link of a built site: its file exists, and so does the place in it.   python docs/links.py FOLDER"""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """What a page links to, and the places in it that can be linked to."""

    def __init__(self, path: Path):
        super().__init__()
        self.targets: set[str] = set()
        self.places: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the targets and places of one tag."""
        for name, value in attrs:
            if name in ("href", "src") and value:
                self.targets.add(value)
            elif name in ("id", "name") and value:
                self.places.add(value)


def broken_links(site: Path) -> list[str]:
    """Return a line per internal link of a folder of HTML pages that leads nowhere."""
    own = (
        path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts
    )  # there lie the theme's templates
    pages = {path.resolve(): Page(path) for path in own}
    broken = []
    for path, page in pages.items():
        for target in sorted(page.targets):
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            file = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            place = unquote(parts.fragment)
            if not file.exists() or (place and file in pages and place not in pages[file].places):
                broken.append(f"{path.relative_to(site.resolve())} links to {target}")
    return broken


if __name__ == "__main__":
    lines = broken_links(Path(sys.argv[1]))
    sys.exit("\n".join(lines) if lines else 0)
