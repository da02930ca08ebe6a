"""`imubayes history`: the models tried."""

from pathlib import Path
from typing import TYPE_CHECKING

from imubayes.cli.options import Json, print_json
from imubayes.cli.session import progress, start_jax

if TYPE_CHECKING:
    from imubayes.loop.model_history import Tree


def history(
    *results: Path,
    select: Path | None = None,
    export: Path | None = None,
    html: Path | None = None,
    as_json: Json = False,
) -> int:
    """Show the models tried, how the error fell, and which one is selected.

    Example: imubayes history results/second --html history.html

    Parameters
    ----------
    results
        Result folders; the models before and after each are found from it.
    select
        Make this result the selected one; to undo a step, select the result before it.
    export
        Write the selected model to this model file.
    html
        Write the models tried, with their evidence, as one HTML page.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.errors import input_error

    folders = [*results, *([select] if select is not None and not results else [])]
    if not folders:
        raise input_error("no result is named", "command line", "result folders", "name at least one")
    with progress() as tell:
        # What reads alone needs no JAX, which takes seconds to import.
        from imubayes.atomic_files import refuse_existing
        from imubayes.display.history_table import history_json, history_report
        from imubayes.display.report_layout import print_report
        from imubayes.results.history_tree import read_tree
        from imubayes.results.history_tree import select as select_node

        if export is not None:
            refuse_existing(export)
        if html is not None:
            refuse_existing(html, but=lambda content: content.startswith(b"<!doctype html>"))
        if select is not None:
            select_node(select)
        tree = read_tree(folders)
        if export is not None:
            start_jax()
            from imubayes.api import export as export_model

            export_model(folders[0], export)
        if html is not None:
            tell("drawing")
            _write_page(html, tree)
    if as_json:
        print_json(history_json(tree))
    else:
        print_report(history_report(tree))
        for file in (file for file in (export, html) if file is not None):
            print(f"written: {file}")
    return 0


def _write_page(html: Path, tree: "Tree") -> None:
    start_jax()
    from imubayes.atomic_files import write_text
    from imubayes.display.history_page import history_page
    from imubayes.results.loop_files import read_steps

    write_text(html, history_page(tree, {place: read_steps(tree, place) for place in tree.selected}))
