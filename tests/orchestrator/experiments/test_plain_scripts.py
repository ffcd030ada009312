"""A script without `if __name__ == "__main__":` runs once, whatever processes it starts."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import hedgerow as hg

print("begins")

class Half(hg.Minimax):
    def act(self, x):
        return super().act(x) / 2

net = hg.load("paper7", steps=5)
table = hg.sweep(net, seeds=range(4), jobs=2, law=["minimax", {law}])
compared = hg.compare(net, [{law}], seeds=range(4), jobs=2)
print(table.num_rows, sum(map(len, compared.rows)))
"""


@pytest.mark.slow
@pytest.mark.parametrize(("law", "rows"), [("'nominal'", [8, 8]), ("Half", [8, 12])], ids=["ours", "in the script"])
def test_a_script_without_a_guard_runs_once(law: str, rows: list[int], tmp_path: Path) -> None:
    file = tmp_path / "script.py"
    file.write_text(SCRIPT.format(law=law))
    done = subprocess.run([sys.executable, file], check=False, capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout.split() == ["begins", *map(str, rows)], done.stderr
    assert not done.stderr
