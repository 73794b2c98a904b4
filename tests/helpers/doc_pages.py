"""The documentation as a reader uses it: its blocks in order, run in a folder that holds what the pages speak of."""

from __future__ import annotations

import contextlib
import io
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from commands import LEG, SAMPLES, TRAIN, VALIDATE, idtool
from descriptions import described
from doc_outputs import check_output, updated_output
from paths import CHECKOUT, REAL
from recordings import State, metadata, ros2, write_mcap

from idtool.data.logs import read_log, write_log
from idtool.data.logs.log import make_log

DOCS = CHECKOUT / "docs"
PAGES = DOCS / "pages"
README = CHECKOUT / "README.md"

SLOW = ("idtool study", "idtool excite", "idtool diagnose", "python", "make demo")  # what takes more than some seconds
_SLOW_WORDS = ("quadruped.urdf", "--track", "bag1", "--method iv", "idtool.diagnose(")
_REAL_URDFS = ("panda.urdf", "go2.urdf")
_REAL_FILES = (
    "panda/panda.urdf",
    "panda/excitation.mcap",
    "go2/go2.urdf",
    *(f"go2/chirp_{k}.csv" for k in range(4, 8)),
)
_RUNS = {  # parts of the leg's logs
    "run1": (TRAIN, slice(0, 2500)),
    "run2": (TRAIN, slice(2500, 5000)),
    "run3": (VALIDATE, slice(0, 2500)),
    "run4": (VALIDATE, slice(2500, 5000)),
}


@dataclass(frozen=True)
class Block:
    """A block of a page: its language, the text, and the line that it starts at."""

    language: str
    text: str
    line: int

    @property
    def commands(self) -> list[str]:
        """The command lines of a shell block, joined where they are continued."""
        lines = self.text.replace("\\\n", " ").splitlines() if self.language == "sh" else []
        return [line for line in map(str.strip, lines) if line and not line.startswith("#")]

    @property
    def slow(self) -> bool:
        """Whether it holds a command that takes long."""
        several = any(line.startswith(SLOW) or line.count(".mcap") > 3 for line in self.commands)
        return several or any(word in self.text for word in _SLOW_WORDS)

    @property
    def real(self) -> bool:
        """Whether it needs logs of real robots, which are no part of the project."""
        return any(name in line for line in self.commands for name in _REAL_URDFS)

    @property
    def file(self) -> str | None:
        """The file that a reader saves it as: its first line is that name."""
        named = re.match(r"# (\w+\.yaml)\n", self.text) if self.language == "yaml" else None
        return named[1] if named else None

    @property
    def writes(self) -> set[str]:
        """Files and folders that it writes, by their first name."""
        found = set(re.findall(r'open\("([^"]*)", "w"', self.text)) if self.language == "python" else set()
        lines = [one for line in self.commands for one in (demo() if line.startswith("make demo") else [line])]
        for words in (shlex.split(line, comments=True) for line in lines):
            if "--out" in words:
                found.add(words[words.index("--out") + 1])
            elif urdfs := [word for word in words if word.endswith(".urdf")]:
                found.add(f"{Path(urdfs[0]).stem}_idtool")
        return found


def pages() -> list[Path]:
    """All pages of the documentation."""
    return sorted(PAGES.rglob("*.md"))


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page, which has no commands elsewhere."""
    found, lines = [], page.read_text().splitlines()
    opened: tuple[str, int] | None = None
    for k, line in enumerate(lines, start=1):
        if fence := re.match(r"\s*```(\w*)$", line):
            if opened:
                found.append(Block(opened[0], "\n".join(lines[opened[1] : k - 1]), opened[1]))
            opened = None if opened else (fence[1], k)
        else:
            assert opened or not re.match(r" {4}(\S*bin/)?(idtool|make|python|source) ", line), f"{page.name}, line {k}"
    assert opened is None, f"{page.name}: a block is not closed"
    return found


@cache
def runs() -> dict[str, bytes]:
    """The logs that pages call run1.mcap and so on."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, (log, samples) in _RUNS.items():
            whole, to = read_log(log), Path(folder, f"{name}.mcap")
            signals = {signal: x[samples] for signal, x in whole.signals.items()}
            write_log(to, make_log(to, whole.t[samples], whole.joints, signals))
            found[to.name] = to.read_bytes()
    return found


BAG = "bag1"  # what pages call a rosbag2 folder


@cache
def bag() -> bytes:
    """The file of a bag with half of a log, and a URDF."""
    whole, half = read_log(TRAIN), slice(0, 5000)
    values = zip(whole.t[half], *(whole.signals[name][half].tolist() for name in ("q", "v", "tau")), strict=True)
    items = [State(stamp := round(1e9 * t) + 10**18, whole.joints, *row, logged=stamp) for t, *row in values]
    with tempfile.TemporaryDirectory() as folder:
        return write_mcap(Path(folder, "bag.mcap"), described(LEG.read_text()), ros2(items)).read_bytes()


def demo() -> list[str]:
    """The commands of `make demo`."""
    recipe = (CHECKOUT / "Makefile").read_text().partition("\ndemo:")[2].partition("\n\n")[0]
    return re.findall(r"^\t\$\(BIN\)/(idtool .*)$", recipe, re.M)


def environment() -> str:
    """The folder that the Makefile makes a virtual environment in."""
    found = re.search(r"-m venv .*?(\S+)$", (CHECKOUT / "Makefile").read_text(), re.M)
    assert found
    return found[1]


@dataclass
class Reader:
    """Does what a page says, in its order.

    Attributes
    ----------
    folder
        Where: holds a robot and logs under the names that pages give them.
    slow
        Whether to do what takes long, too.
    update
        True to write outputs that have changed into the page, false to fail.
    """

    folder: Path
    slow: bool
    update: bool = False
    here: Path = field(init=False)
    said: str = field(init=False, default="")
    variables: dict[str, Any] = field(init=False, default_factory=dict)
    left_out: set[str] = field(init=False, default_factory=set)

    def __post_init__(self) -> None:
        self.here = self.folder
        for name in ("configs", "benchmarks"):
            (self.folder / name).symlink_to(CHECKOUT / name)
        for stem in ("robot", "leg"):
            for ending in (".urdf", ".yaml"):
                shutil.copy((SAMPLES / "leg").with_suffix(ending), self.folder / f"{stem}{ending}")
        for name, log in runs().items():
            (self.folder / name).write_bytes(log)

    def read(self, page: Path) -> None:
        """Do all of a page."""
        if page == README:  # it is read in a checkout; the other pages write the samples that they use
            shutil.copytree(SAMPLES, self.folder / "sample_logs")
        for block in self._wanted(blocks(page)):
            if block.real:
                self._lay_out_real_logs()
            if block.language == "sh" and re.search(rf"\b{BAG}\b", block.text):
                self._lay_out_bag()
            where = f"{page.name}, line {block.line}"
            if block.language == "sh":
                self.said = "".join(self._command(line, where) for line in block.commands)
            elif block.language == "python":
                self.said = self._script(block)
            elif block.file:
                (self.here / block.file).write_text(block.text)
            elif block.language == "text" and self.said:
                self._compare(page, block, where)

    def _compare(self, page: Path, block: Block, where: str) -> None:
        """Compare a block with what was printed; with `update`, write that into the page."""
        try:
            check_output(block.text, self.said, where)
        except AssertionError:
            if not self.update:
                raise
            text = page.read_text()
            assert text.count(block.text) == 1, f"{where}: the page has this output twice; update it by hand"
            page.write_text(text.replace(block.text, updated_output(block.text, self.said)))

    def _wanted(self, found: list[Block]) -> Iterator[Block]:
        """The blocks to run: without `slow`, those that take long and those that need their files are left out."""
        for block in found:
            rests = any(re.search(rf"(?<!\w){re.escape(name)}\b", block.text) for name in self.left_out)
            if block.language in ("sh", "python") and (not self.slow and (block.slow or block.real or rests)):
                self.left_out |= block.writes
                self.said = ""
            elif block.real and not REAL.is_dir():
                self.said = ""
            else:
                yield block

    def _lay_out_real_logs(self) -> None:
        for name in _REAL_FILES:
            link = self.folder / Path(name).name
            if not link.exists():
                link.symlink_to(REAL / name)

    def _lay_out_bag(self) -> None:
        folder = self.folder / BAG
        if not folder.exists():
            folder.mkdir()
            (folder / f"{BAG}_0.mcap").write_bytes(bag())
            (folder / "metadata.yaml").write_text(metadata([f"{BAG}_0.mcap"]))

    def _command(self, line: str, where: str) -> str:
        """What a command line prints; it must end with the code that stands behind it, 0 where none does."""
        words = shlex.split(line, comments=True)
        stated = re.search(r"#\s*exit (\d)$", line)
        if line.startswith("make demo"):
            return "".join(self._command(one, where) for one in demo())
        if words[0] == "cd":
            self.here = (self.here / words[1]).resolve()
            assert self.here.is_dir(), where
            return ""
        if words[0] == "source":
            return self._activate(line, where)
        if words[0] == "python":
            done = subprocess.run([sys.executable, *words[1:]], cwd=self.here, capture_output=True, text=True)
            assert done.returncode == 0, f"{where}: {done.stderr}"
            return done.stdout
        assert words[0] == "idtool", f"{where}: no test runs {words[0]}"
        if words[1] == "init" and not {"--out", "--force"} & set(words):
            (self.here / words[2]).with_suffix(".yaml").unlink(missing_ok=True)  # as for a reader who has none
        result = idtool(*words[1:], folder=self.here)
        assert result.code == int(stated[1] if stated else 0), f"{where}: {line}: {result.code}: {result.err}"
        return result.out

    def _activate(self, line: str, where: str) -> str:
        """Do so in a shell that has no environment, with the one that this runs in where `make demo` makes one."""
        link = self.here / environment()
        link.symlink_to(sys.prefix)
        shell = ["env", "-i", "PATH=/usr/bin:/bin", "bash", "-ec", f"{line}\ncommand -v idtool python"]
        done = subprocess.run(shell, cwd=self.here, capture_output=True, text=True)
        link.unlink()
        found = [Path(one) for one in done.stdout.split()]
        assert [one.resolve().parent for one in found[:1]] == [Path(sys.prefix, "bin").resolve()], (
            f"{where}: {done.stderr}"
        )
        assert len(found) == 2, f"{where}: {done.stdout}"
        return ""

    def _script(self, block: Block) -> str:
        """What a Python block prints; blocks of a page see each other's names."""
        script, out = self.folder / "block.py", io.StringIO()
        script.write_text(block.text)
        with contextlib.chdir(self.here), contextlib.redirect_stdout(out):
            self.variables = runpy.run_path(str(script), self.variables)
        return out.getvalue()
