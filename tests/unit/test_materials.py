"""Bill of materials, licence list and the workflow keep step with lock, project and scripts."""

import json
import re
import runpy
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "bill-of-materials.py"))
LOCK = (ROOT / "requirements.lock").read_text(encoding="utf-8")


def required(*extras: str) -> set[str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *(d for e in extras for d in project["optional-dependencies"][e])]
    return {re.split(r"[\[<>=!~; ]", d)[0].lower() for d in wanted}


def test_everything_that_the_image_needs_is_pinned_and_in_both_lists_and_no_tool_of_the_developers(
    tmp_path: Path,
) -> None:
    assert SCRIPT["main"]([str(tmp_path)]) == 0
    pins = {
        tuple(x.split(";")[0].strip().split("==")) for x in LOCK.splitlines() if "==" in x and x[0] != "#"
    }
    document = json.loads((tmp_path / "sbom.json").read_text())
    assert (document["bomFormat"], document["specVersion"]) == ("CycloneDX", "1.5")
    listed = {(c["name"], c["version"]) for c in document["components"]}
    names = {name for name, _ in listed}
    assert listed <= pins
    assert required("postgres") <= names
    assert "starlette" in names  # what is needed by what is needed
    developers = required("tests", "docs", "checks", "bench") - required("postgres") - {"invid"}
    assert len(developers) > 15
    assert not developers & names
    assert developers <= {name.lower() for name, _ in pins}
    refs = [c["bom-ref"] for c in document["components"]]
    assert len(set(refs)) == len(refs)
    table = (tmp_path / "licences.md").read_text()
    for name, version in listed:
        assert re.search(rf"\| {re.escape(name)}( \(.+\))? \| {re.escape(version)} \| .+ \|", table), name
