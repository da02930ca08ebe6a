"""What a result comes from, in one line for the foot of a page."""

from imubayes.results.provenance_record import FitProvenance

_MOST_DIGITS = 12


def provenance_line(found: FitProvenance | None) -> str:
    """Return serial, dates, hashes, seed and the version of imubayes; empty for a result of an earlier version."""
    if found is None:
        return ""
    first, last = found.first_run, found.last_run
    days = list(dict.fromkeys(day[:10] for day in (first, last) if day is not None))
    versions = {each.package: each.version for each in found.software}
    parts = (
        f"unit {found.serial}" if found.serial else "unit without serial number",
        f"recorded {' to '.join(days)}" if days else "",
        f"fitted {found.fitted[:16].replace('T', ' ')} UTC",
        f"data SHA-256 {found.data_sha256[:_MOST_DIGITS]}…",
        f"model SHA-256 {found.model_sha256[:_MOST_DIGITS]}…",
        f"seed {found.seed}",
        f"imubayes {versions.get('imubayes', '?')}, JAX {versions.get('jax', '?')}",
    )
    return "; ".join(part for part in parts if part)
