"""`imubayes selftest`: the known answers that an installation reproduces."""

from imubayes.cli.session import Json, progress, show, start_jax


def selftest(as_json: Json = False) -> int:
    """Verify the installation: compute published values, and a campaign whose answer is known by construction.

    Allan deviations (NIST SP 1065), propagation (JCGM 101), conformity (JCGM 106), sampling (GUM H.3) and a joint fit.
    The exit status is 1 if a value differs.

    Example: imubayes selftest

    Parameters
    ----------
    as_json
        Print one JSON object on standard output.
    """
    with progress() as tell:
        start_jax("known answers")
        from imubayes_qualification.api.own_equation import selftest as known_answers
        from imubayes_qualification.display.own_equation import selftest_record, selftest_report

        answers = known_answers(tell)
        record = selftest_record(answers)
    show(lambda: record, lambda: selftest_report(record), as_json)
    return 0 if all(answer.agrees for answer in answers) else 1
