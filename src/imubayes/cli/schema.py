"""`imubayes schema`: JSON Schema of the files, for editors."""

import json
import sys
from typing import Literal


def schema(kind: Literal["campaign", "model"]) -> int:
    """Print the JSON Schema of campaign.toml or of a model file, for completion and checks in an editor.

    Example: imubayes schema campaign > campaign.schema.json

    Parameters
    ----------
    kind
        Which file.
    """
    from imubayes.campaign.file_schemas import campaign_schema, model_schema

    json.dump(campaign_schema() if kind == "campaign" else model_schema(), sys.stdout, indent=1)
    print()
    return 0
