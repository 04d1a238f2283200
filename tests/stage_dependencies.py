"""Which of the project's own modules each stage runs, read from the imports."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = {"addressed_dynamics": "src/addressed_dynamics", "pipeline": "pipeline"}


def first_party(root: Path, stage: str, kind: str) -> set[str]:
    """Return the modules that `pipeline/<stage>.py` imports, itself included, as paths relative to `root`.

    What a kind supplies, `supplied("features", …)`, counts for `kind`.

    With a module come the files in the `templates` folder beside it.
    Lazy imports inside functions count. In the `__init__.py` of a package that is only passed on the way to one of its
    modules they do not: nobody calls those functions.
    """
    found: dict[str, bool] = {}
    waiting = [(f"pipeline.{stage}", True)]
    while waiting:
        module, lazy_too = waiting.pop()
        path = _path(root, module)
        if path is None or found.get(path, False) or (path in found and not lazy_too):
            continue
        found[path] = lazy_too
        tree = ast.parse((root / path).read_text(encoding="utf-8"))
        supplied = [f"addressed_dynamics.{layer}.{kind}.{module}" for layer, module in _layers(tree)]
        for target in (*_imported(root, tree, lazy_too=lazy_too), *supplied):
            waiting.append((target, True))
            waiting += [(parent, False) for parent in _parents(target)]
        waiting += [(parent, False) for parent in _parents(module)]
    templates = {file for path in found for file in (root / path).parent.glob("templates/*")}
    return set(found) | {file.relative_to(root).as_posix() for file in templates}


def _imported(root: Path, tree: ast.Module, *, lazy_too: bool) -> Iterator[str]:
    for node in _nodes(tree, lazy_too=lazy_too):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                yield submodule if _path(root, submodule) else node.module


def _layers(tree: ast.AST) -> Iterator[tuple[str, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "supplied":
            layer, _, *module = node.args
            assert isinstance(layer, ast.Constant)
            yield layer.value, *(ast.literal_eval(each) for each in module or [ast.Constant("kind")])


def _nodes(node: ast.AST, *, lazy_too: bool) -> Iterator[ast.AST]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef) and not lazy_too:
            continue
        if isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
            continue
        yield child
        yield from _nodes(child, lazy_too=lazy_too)


def _parents(module: str) -> list[str]:
    parts = module.split(".")
    return [".".join(parts[:end]) for end in range(1, len(parts))]


def _path(root: Path, module: str) -> str | None:
    package, *rest = module.split(".")
    if package not in SOURCES:
        return None
    base = Path(SOURCES[package], *rest)
    candidates = (base.with_suffix(".py"), base / "__init__.py")
    return next((path.as_posix() for path in candidates if (root / path).is_file()), None)
