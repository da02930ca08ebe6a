"""`imubayes archive`: campaign folders as one Parquet dataset."""

from pathlib import Path

import cyclopts

from imubayes.cli.options import Json, print_json

archive = cyclopts.App(name="archive", help="Keep many campaigns as one Parquet dataset: pack, list, check.")


@archive.command
def pack(*folders: Path, out: Path, as_json: Json = False) -> int:
    """Add campaign folders to an archive; what it holds already is passed over, and nothing is rewritten.

    Example: imubayes archive pack campaigns --out archive

    Parameters
    ----------
    folders
        Campaign folders, or folders that contain such folders.
    out
        Archive to add to; made where there is none.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.cli.session import progress

    with progress() as tell:
        from imubayes.archive import campaign_folders
        from imubayes.archive import pack as pack_folders
        from imubayes.display.archive_report import packed_json, packed_report
        from imubayes.display.report_layout import print_report

        packed = pack_folders(campaign_folders(folders), out, tell)
    if as_json:
        print_json(packed_json(packed))
    else:
        print_report(packed_report(packed, out))
    return 1 if packed.refused else 0


@archive.command(name="list")
def list_campaigns(archive: Path, *, as_json: Json = False) -> int:
    """List the campaigns of an archive, by unit and date.

    Example: imubayes archive list archive

    Parameters
    ----------
    archive
        Archive folder.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.archive.store import open_archive
    from imubayes.display.archive_report import list_json, list_report
    from imubayes.display.report_layout import print_report

    campaigns = open_archive(archive).campaigns()
    if as_json:
        print_json(list_json(campaigns))
    else:
        print_report(list_report(campaigns))
    return 0


@archive.command
def check(archive: Path, *, as_json: Json = False) -> int:
    """Read every campaign of an archive and verify its checksum, its name and its place.

    Example: imubayes archive check archive

    Parameters
    ----------
    archive
        Archive folder.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.archive.store import open_archive
    from imubayes.cli.session import progress
    from imubayes.display.archive_report import check_json, check_report
    from imubayes.display.report_layout import print_report

    opened = open_archive(archive)
    with progress() as tell:
        issues = opened.check(tell)
    if as_json:
        print_json(check_json(len(opened.files()), issues))
    else:
        print_report(check_report(len(opened.files()), issues))
    return 1 if issues else 0
