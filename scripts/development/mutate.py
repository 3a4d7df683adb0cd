"""Do the tests see when the mathematics is wrong? Small errors are put into it, one at a time, and the tests run.

    python scripts/development/mutate.py [--most 12] [--only noise] [--out docs/mutation.md]

Every mutant is one exchanged operator, comparison, constant, function or left-out statement in one module. It counts as
killed when a test of the module fails, or takes several times as long. Survivors are told with the answer that
scripts/development/mutation_answers.json has for them: why they are equivalent, or what is accepted.

Of the well-kept tools, mutmut 3 leaves out what has a decorator and constants of modules, where much of a numerical
library is, and cosmic-ray starts an interpreter for each mutant: three seconds to import Pinocchio, SciPy and pytest,
against one for the tests. Here they are imported once, and every mutant is a fork of that process.
"""

import argparse
import ast
import copy
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import random
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import pytest

ROOT = Path(__file__).resolve().parents[2]
ANSWERS = ROOT / "scripts/development/mutation_answers.json"

OBSERVATIONS = "identification/test_observations"
OF_SYSTEMS = (
    "identification/test_jacobian",
    "properties/test_calibrations",
    f"{OBSERVATIONS}::test_columns_match_central_differences",
)
# The tests of each module, quick ones first.
ROOMS: dict[str, tuple[str, ...]] = {
    "foundations/rigid": ("foundations/test_rigid", "properties/test_rigid", "robot/test_deviation"),
    "foundations/linear": (
        "foundations/test_linear",
        "identification/test_elimination",
        "identification/test_jacobian",
        "identification/test_noise",
    ),
    "robot/deviation": ("robot/test_deviation", "properties/test_arms"),
    "robot/skeleton": ("properties/test_arms", "robot/test_robot", "identification/test_jacobian", "robot/test_loops"),
    "robot/kinematics": ("properties/test_arms", "robot/test_gravity", "identification/test_jacobian"),
    "robot/loops": ("robot/test_loops", "identification/test_loops_model"),
    "robot/transmission": (
        "robot/test_transmission",
        "robot/test_terms",
        "identification/test_joint_terms",
        "identification/test_conditions",
    ),
    "robot/flexures": ("robot/test_flexures", "identification/test_links"),
    "robot/gravity": ("robot/test_gravity", "robot/test_flexures", "identification/test_links"),
    "identification/relations": (
        f"{OBSERVATIONS}::test_relations_match_central_differences",
        f"{OBSERVATIONS}::test_known_distances_between_sockets_give_the_size",
        f"{OBSERVATIONS}::test_relations_that_cannot_be",
    ),
    "identification/stances": ("identification/test_observations", "identification/test_touches"),
    "identification/unseen_strains": ("identification/test_observations", "identification/test_touches"),
    "identification/noise": ("identification/test_noise", "assessment/test_nist"),
    "identification/weights": ("identification/test_noise", "assessment/test_nist", "assessment/test_outliers"),
    "identification/losses": ("identification/test_losses", "assessment/test_outliers"),
    "identification/widths": ("identification/test_learned_priors",),
    "identification/identifiability": ("identification/test_identifiability", "properties/test_calibrations"),
    "identification/system": OF_SYSTEMS,
    "identification/rates": OF_SYSTEMS,
    "identification/selection": OF_SYSTEMS,
    "identification/rows": OF_SYSTEMS,
    "identification/solver": ("assessment/test_nist", "properties/test_calibrations", "identification/test_identify"),
    "identification/observations/pose": ("identification/test_jacobian",),
    "identification/observations/distance": (f"{OBSERVATIONS}::test_columns_match_central_differences",),
    "identification/observations/plane": (f"{OBSERVATIONS}::test_columns_match_central_differences",),
    "identification/observations/socket": (f"{OBSERVATIONS}::test_columns_match_central_differences",),
    "identification/observations/pixels": ("identification/test_pixels",),
    "machine/uncertainty": ("machine/test_uncertainty", "machine/test_own_noise"),
}
BINARY: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.Mod: ast.Mult,
    ast.FloorDiv: ast.Mult,
}
COMPARE: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
NAMES = {
    "maximum": "minimum",
    "minimum": "maximum",
    "max": "min",
    "min": "max",
    "sin": "cos",
    "cos": "sin",
    "any": "all",
    "all": "any",
    "zeros": "ones",
    "argmax": "argmin",
    "hstack": "vstack",
    "mean": "sum",
    "sum": "mean",
    "hypot": "subtract",
}


@dataclass(frozen=True)
class Mutant:
    """One change: the number of its node in the order of ``ast.walk``, of its kind, and what it says."""

    module: str
    where: str
    line: int
    node: int
    kind: int
    before: str
    after: str

    @property
    def key(self) -> str:
        return f"{self.module} {self.where}: {self.before} -> {self.after}"


def changes(node: ast.AST) -> Iterator[Callable[[], ast.AST]]:
    """Yield what may be made of a node; each call changes a copy of it."""

    def changed(act: Callable[[ast.AST], object]) -> Callable[[], ast.AST]:
        def make() -> ast.AST:
            new = copy.deepcopy(node)
            act(new)
            return new

        return make

    match node:
        case ast.BinOp(op=ast.MatMult()):
            yield lambda: ast.BinOp(node.right, ast.MatMult(), node.left)
        case ast.BinOp(op=op) if type(op) in BINARY:
            yield changed(lambda new: setattr(new, "op", BINARY[type(op)]()))
        case ast.AugAssign(op=op):
            if type(op) in BINARY:
                yield changed(lambda new: setattr(new, "op", BINARY[type(op)]()))
            yield ast.Pass
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=inner):
            yield lambda: inner
        case ast.Compare(ops=[op]):
            for other in COMPARE[type(op)]:
                yield changed(lambda new, other=other: setattr(new, "ops", [other()]))
        case ast.BoolOp(op=op):
            yield changed(lambda new: setattr(new, "op", ast.Or() if isinstance(op, ast.And) else ast.And()))
        case ast.Constant(value=bool(v)):
            yield lambda: ast.Constant(not v)
        case ast.Constant(value=int(v)):
            yield lambda: ast.Constant(v + 1)
        case ast.Constant(value=float(v)):
            # A tolerance that is twice as large is rarely another; one that is a thousand times as large is.
            yield lambda: ast.Constant(1.0 if v == 0.0 else 1e3 * v if v < 1e-2 else 2.0 * v)
        case ast.Attribute(attr=name) if name in NAMES:
            yield changed(lambda new: setattr(new, "attr", NAMES[name]))
        case ast.IfExp():
            yield lambda: ast.IfExp(node.test, node.orelse, node.body)
        case ast.Call(func=ast.Attribute(attr="swapaxes" | "copy"), args=[inner, *_]):
            yield lambda: inner
        case ast.Raise() | ast.Break() | ast.Continue() | ast.Expr(value=ast.Call()):
            yield ast.Pass


def sites(tree: ast.Module) -> Iterator[tuple[int, str, ast.AST]]:
    """Yield number, surrounding definition and node of all that may be changed: no types, texts or decorators."""
    number = {node: k for k, node in enumerate(ast.walk(tree))}

    def walk(node: ast.AST, where: str) -> Iterator[tuple[int, str, ast.AST]]:
        match node:
            case ast.JoinedStr() | ast.Assert() | ast.Import() | ast.ImportFrom():
                return
            case ast.keyword(arg="strict" | "eq" | "slots" | "frozen"):
                return
            case ast.Assign(targets=[ast.Name(id=name)]) if not where and not name.startswith("_"):
                inside: list[ast.AST] = [node.value]
            case ast.AnnAssign():
                inside = [] if node.value is None else [node.value]
            case ast.FunctionDef() | ast.ClassDef():
                where = f"{where}.{node.name}".lstrip(".")
                inside = list(node.body)
                if isinstance(node, ast.FunctionDef):
                    inside += [*node.args.defaults, *(d for d in node.args.kw_defaults if d is not None)]
            case ast.Call(func=ast.Name(id="cast" | "NamedTuple" | "Parameter")):
                inside = node.args[1:]
            case _:
                inside = list(ast.iter_child_nodes(node))
        yield number[node], where, node
        for child in inside:
            yield from walk(child, where)

    for statement in tree.body:
        yield from walk(statement, "")


def source_of(module: str) -> str:
    return (ROOT / "calib" / f"{module}.py").read_text(encoding="utf-8")


def mutants_of(module: str) -> list[Mutant]:
    """All mutants of a module; what reads the same in one definition is one of them."""
    found: dict[str, Mutant] = {}
    for number, where, node in sites(ast.parse(source_of(module))):
        for kind, change in enumerate(changes(node)):
            new = change()
            before, after = ast.unparse(node), ast.unparse(ast.fix_missing_locations(new))
            if before == after:
                continue
            if isinstance(node, ast.Constant | ast.Attribute):
                line = source_of(module).splitlines()[node.lineno - 1].strip()
                after = f"{after} in `{line}`, column {node.col_offset}"
            mutant = Mutant(module, where or "module", getattr(node, "lineno", 0), number, kind, before, after)
            found.setdefault(mutant.key, mutant)
    return list(found.values())


def mutated(mutant: Mutant) -> ast.Module:
    tree = ast.parse(source_of(mutant.module))
    target = list(ast.walk(tree))[mutant.node]

    class Change(ast.NodeTransformer):
        def visit(self, node: ast.AST) -> ast.AST:
            if node is target:
                return list(changes(node))[mutant.kind]()
            return super().generic_visit(node)

    return ast.fix_missing_locations(Change().visit(tree))


class Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports one module from another tree than its file's."""

    def __init__(self, name: str, tree: ast.Module) -> None:
        self._name, self._tree = name, tree

    def find_spec(
        self, name: str, _path: Sequence[str] | None = None, _target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if name != self._name:
            return None
        return importlib.util.spec_from_loader(name, self, is_package=False)

    def exec_module(self, module: ModuleType) -> None:
        exec(compile(self._tree, f"<mutant of {self._name}>", "exec"), module.__dict__)


def preload() -> None:
    """Import what takes long, and forget calib and its tests again, so that every fork imports its own."""
    for name in ("calib.cli", "calib.job.calibrate", "scipy.spatial.transform", "scipy.stats", "trimesh"):
        importlib.import_module(name)
    for name in [name for name in sys.modules if name.partition(".")[0] in ("calib", "tests")]:
        del sys.modules[name]


def path_of(test: str) -> str:
    """The path of a folder, a file, or a test of a file after "::"."""
    file, mark, name = test.partition("::")
    path = ROOT / "tests" / file
    return str(path) if path.is_dir() else f"{path}.py{mark}{name}"


def run(mutant: Mutant | None, tests: Sequence[str], limit: float) -> str:
    """Return "killed", "slow" or "survived" for the tests in a fork of this process."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            nothing = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nothing, 1)
            os.dup2(nothing, 2)
            if mutant is not None:
                name = "calib." + mutant.module.replace("/", ".")
                sys.meta_path.insert(0, Finder(name, mutated(mutant)))
            paths = [path_of(test) for test in tests]
            code = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *paths]))
        finally:
            os._exit(code)
    end = time.monotonic() + limit
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return "killed" if os.waitstatus_to_exitcode(status) else "survived"
        time.sleep(0.02)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return "slow"


def judged(
    module: str, most: int, seed: int, known: dict[str, str], keep: Callable[[dict[str, str]], None]
) -> dict[str, str]:
    """Run a seeded sample of a module's mutants, but for those already ``known``; ``keep`` is told each one's end."""
    mutants = mutants_of(module)
    sample = random.Random(f"{seed} {module}").sample(mutants, min(most, len(mutants)))
    limit, found = 0.0, {}
    for k, mutant in enumerate(sorted(sample, key=lambda m: (m.line, m.key))):
        result = known.get(mutant.key)
        if result is None:
            limit = limit or limit_of(module)
            result = run(mutant, ROOMS[module], limit)
        found[mutant.key] = result
        print(f"{module} {k + 1}/{len(sample)} {result}: line {mutant.line}, {mutant.key}", flush=True)
        keep({mutant.key: result})
    return found


def limit_of(module: str) -> float:
    """How many seconds a mutant may take: several times what the tests take without one."""
    start = time.monotonic()
    if run(None, ROOMS[module], 3600.0) != "survived":
        raise SystemExit(f"{module}: its tests fail without any change.")
    return 10.0 + 4.0 * (time.monotonic() - start)


def page(results: dict[str, dict[str, str]], answers: dict[str, str], most: int, seed: int) -> str:
    lines = [
        "# Do the tests see wrong mathematics?",
        "",
        f"Made by `python scripts/development/mutate.py`, whose first lines say how: up to {most} mutants of a module,",
        f"drawn with seed {seed}. Killed are those that make a test fail or hang. Every survivor is told with its",
        "answer. A module with fewer tried is not through yet.",
        "",
        "| module | mutants | tried | killed | equivalent | accepted | open |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    total = [0] * 6
    for module, found in results.items():
        survivors = [key for key, result in found.items() if result == "survived"]
        said = [answers.get(key, "").partition(":")[0] for key in survivors]
        equivalent, accepted = said.count("equivalent"), said.count("accepted")
        row = [
            len(mutants_of(module)),
            len(found),
            len(found) - len(survivors),
            equivalent,
            accepted,
            len(said) - equivalent - accepted,
        ]
        total = [a + b for a, b in zip(total, row, strict=True)]
        lines.append(f"| {module} | {' | '.join(map(str, row))} |")
    lines += [f"| **all** | {' | '.join(map(str, total))} |", "", "## Survivors", ""]
    for found in results.values():
        for key, result in found.items():
            if result == "survived":
                lines.append(f"- {key.replace('|', chr(92) + '|')}: {answers.get(key, 'open')}")
    return "\n".join([*lines, ""])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--most", type=int, default=12, help="mutants of a module")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", action="append", help="part of a module's name; nothing is written then")
    parser.add_argument("--known", type=Path, help="results of this script that are taken and kept here, as JSON")
    parser.add_argument("--again", action="store_true", help="try what is known to have survived again")
    parser.add_argument("--page", action="store_true", help="run nothing, write the page of what is known")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "mutation.md")
    arguments = parser.parse_args()
    known: dict[str, str] = {}
    if arguments.known is not None and arguments.known.exists():
        known = json.loads(arguments.known.read_text(encoding="utf-8"))
    taken = {key: result for key, result in known.items() if not (arguments.again and result == "survived")}

    def keep(found: dict[str, str]) -> None:
        known.update(found)
        if arguments.known is not None:
            arguments.known.write_text(json.dumps(known, indent=0), encoding="utf-8")

    os.chdir(ROOT)
    results: dict[str, dict[str, str]] = {}
    if not arguments.page:
        preload()
    for module in ROOMS:
        if arguments.page:
            results[module] = {m.key: known[m.key] for m in mutants_of(module) if m.key in known}
        elif arguments.only is None or any(part in module for part in arguments.only):
            results[module] = judged(module, arguments.most, arguments.seed, taken, keep)
    if arguments.only is None:
        answers = json.loads(ANSWERS.read_text(encoding="utf-8"))
        text = page(results, answers, arguments.most, arguments.seed)
        arguments.out.write_text(text, encoding="utf-8", newline="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
