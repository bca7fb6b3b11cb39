"""Templates of the HTML pages that are written as files."""

from __future__ import annotations

from jinja2 import Environment, PackageLoader, StrictUndefined, Template, select_autoescape


def html_template(package: str, name: str) -> Template:
    """Return the template `name` in the folder of `package`. Values are escaped, and a name without a value is an
    error."""
    environment = Environment(
        loader=PackageLoader(package, package_path=""),
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name)
