"""A PEP 517 backend that zips one pure-Python package into a wheel."""

import base64
import hashlib
import tomllib
import zipfile
from pathlib import Path


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    here = Path(__file__).parent
    table = tomllib.loads((here / "pyproject.toml").read_text("utf-8"))
    project = table["project"]
    stem = f"{project['name'].replace('-', '_')}-{project['version']}"
    info = f"{stem}.dist-info"
    package = here / table["tool"]["minimal_backend"]["package"]
    files = {p.relative_to(here).as_posix(): p.read_bytes() for p in sorted(package.rglob("*")) if p.suffix in (".py", ".toml")}
    needed = "".join(f"Requires-Dist: {d}\n" for d in project["dependencies"])
    points = "".join(f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in names.items()) for group, names in project["entry-points"].items())
    files[f"{info}/METADATA"] = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n{needed}".encode()
    files[f"{info}/WHEEL"] = b"Wheel-Version: 1.0\nGenerator: minimal_backend\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    files[f"{info}/entry_points.txt"] = points.encode()
    record = "".join(f"{name},sha256={_digest(content)},{len(content)}\n" for name, content in files.items())
    files[f"{info}/RECORD"] = f"{record}{info}/RECORD,,\n".encode()
    wheel = f"{stem}-py3-none-any.whl"
    with zipfile.ZipFile(Path(wheel_directory) / wheel, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return wheel


def _digest(content):
    return base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
