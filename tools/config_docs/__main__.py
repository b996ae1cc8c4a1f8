"""Write docs/reference/configuration.md and config/schema.json from the settings' types."""

import json
from pathlib import Path

from config_docs.page import configuration_page
from config_docs.schema import json_schema

ROOT = Path(__file__).resolve().parents[2]

if __name__ == "__main__":
    (ROOT / "docs" / "reference" / "configuration.md").write_text(
        configuration_page(), encoding="utf-8"
    )
    schema = json.dumps(json_schema(), indent=2) + "\n"
    (ROOT / "config" / "schema.json").write_text(schema, encoding="utf-8")
