"""`imubayes schema`: JSON Schema of the files, for editors and readers of results."""

import json
from importlib import import_module

from imubayes.errors import closest_first, input_error

_RECORDS = {
    "campaign": ("imubayes.campaign.file_schemas", "CampaignFile"),
    "model": ("imubayes.campaign.file_schemas", "ModelFile"),
    "plan": ("imubayes.simulation.test_plan", "PlanFile"),
    "specification": ("imubayes.qualification.specification", "SpecificationFile"),
    "constants": ("imubayes.qualification.onboard_record", "OnboardConstants"),
    "diagnosis": ("imubayes.criticism.diagnosis_record", "Diagnosis"),
    "change": ("imubayes.results.model_change", "ModelChange"),
    "history": ("imubayes.loop.model_history", "Node"),
    "fit": ("imubayes.results.fit_file", "FitRecord"),
    "report": ("imubayes.qualification.report_record", "QualificationReport"),
    "manifest": ("imubayes.results.manifest", "Manifest"),
    "summary": ("imubayes.results.summary", "Summary"),
}
"""Kind of file → module and name of its pydantic record."""


def schema(kind: str) -> int:
    """Print the JSON Schema of a file, for completion and validation in an editor.

    Example: imubayes schema campaign > campaign.schema.json

    Parameters
    ----------
    kind
        campaign (campaign.toml), model, plan; report; constants (of `imubayes export`); summary, fit, diagnosis,
        change, history or manifest (JSON files of a result).
    """
    if kind not in _RECORDS:
        allowed = closest_first(kind, _RECORDS)
        raise input_error(f"there is no schema '{kind}'", "argument KIND", allowed, "use one of the allowed kinds")
    module, record = _RECORDS[kind]
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    print(json.dumps(dialect | getattr(import_module(module), record).model_json_schema(), indent=1))
    return 0
