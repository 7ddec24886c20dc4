"""One process at a time has a claim: another one is kept out, and let in when it ends."""

import subprocess
import sys

from maax_mjx.common.claim import Claim

HOLD = """
import sys
from pathlib import Path
from maax_mjx.common.claim import Claim
claim = Claim(Path(sys.argv[1]))
print(claim.take(), flush=True)
sys.stdin.read()
"""


def test_another_process_is_kept_out_until_it_ends(tmp_path):
    path = tmp_path / ".lock"
    held = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert held.stdout.readline() == "True\n"
    claim = Claim(path)
    assert not claim.take()
    held.kill()
    held.wait()
    assert claim.take(), "it is free once its process was killed"
    assert claim.take()
    assert Claim(path).take(), "objects of one process do not keep each other out"
    claim.give_up()
    again = subprocess.run(
        [sys.executable, "-c", HOLD, str(path)], input="", capture_output=True, text=True, check=True
    )
    assert again.stdout == "True\n"
