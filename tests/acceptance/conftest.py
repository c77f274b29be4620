import shutil
import subprocess

import pytest


@pytest.fixture(scope="session")
def npm_packages(tmp_path_factory):
    """A folder with @mcap/core and @mcap/support, as npm has them today."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("node and npm are not installed")
    folder = tmp_path_factory.mktemp("node")
    (folder / "package.json").write_text('{"private": true, "type": "module"}')
    command = ["npm", "install", "--no-audit", "--no-fund", "@mcap/core@2", "@mcap/support@1"]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)
    except subprocess.TimeoutExpired:
        pytest.skip("npm takes too long to fetch @mcap/core")
    if done.returncode:
        pytest.skip(f"npm cannot fetch @mcap/core: {done.stderr.strip()[-200:]}")
    return folder
