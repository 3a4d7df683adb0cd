"""Does the verdict say no where it must, and yes where it may? Sound and bad sessions, judged in one process.

python scripts/studies/verdicts.py [--sound 500] [--seeds 2] [--only bad|sound|later] [--out docs/verdicts.md]
"""

import argparse
import json
import sys
import time
import warnings
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from scripts.studies.verdict_sessions import BAD, LATER, bad, judge, sound

ROBOTS = ("ur5", "ur10", "panda")
LATER_ROBOT = "xarm7"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sound", type=int, default=500)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--only", default="")
    parser.add_argument("--what", default="")
    parser.add_argument("--log", type=Path)
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    lines = []
    if args.only in ("", "sound"):
        for seed in range(args.first, args.first + args.sound):
            began = time.time()
            session = sound(seed)
            found = judge(session)
            lines.append({"set": "sound", "seed": seed, **session.label, "word": found.word, "failed": found.failed,
                          "said": found.said, "checks": found.checks, "seconds": time.time() - began})  # fmt: skip
            if found.word != "trusted":
                print("SOUND", seed, session.label, found.word, found.failed, found.said[:400], flush=True)
        print(Counter(line["word"] for line in lines), sum(line["seconds"] for line in lines))
    for name, table, robots in (("bad", BAD, ROBOTS), ("later", LATER, (LATER_ROBOT,))):
        if args.only not in ("", name):
            continue
        for what in table:
            if args.what and args.what not in what:
                continue
            for which in robots:
                for seed in range(args.seeds):
                    session = bad(what, which, seed)
                    found = judge(session)
                    lines.append({"set": name, "seed": seed, "what": what, "robot": which, "word": found.word,
                                  "failed": found.failed, "said": found.said, "checks": found.checks})  # fmt: skip
                    mark = "!!!" if found.word == "trusted" else "   "
                    print(mark, what, "|", which, seed, found.word, found.failed, flush=True)
    if args.log:
        args.log.write_text(json.dumps(lines, indent=1))


if __name__ == "__main__":
    main()
