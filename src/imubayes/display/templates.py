"""The HTML templates of the package; everything put into them is escaped."""

from jinja2 import Environment, PackageLoader, StrictUndefined

_ENVIRONMENT = Environment(
    loader=PackageLoader("imubayes.display"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


def render(name: str, **context: object) -> str:
    """Return the HTML of `templates/NAME.html.j2`.

    A table is drawn by the macro `sheet_table(sheet, folded=false, alarm=true)` of `sheet.html.j2`.
    """
    return _ENVIRONMENT.get_template(f"{name}.html.j2").render(context)
