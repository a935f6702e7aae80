"""The parser of expressions: `ast` parses a text, which is compiled to a program by a whitelist; no Python is
evaluated.

Expressions consist of ``+ - * / **``, parentheses, numbers, ``pi``, functions, and operands that depend on the context:
time, an angle, parameters, quantities of a run, columns of a table. Each context is a subclass of `Compiler`.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import lru_cache
from itertools import islice
from typing import TYPE_CHECKING, ClassVar, NoReturn

from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.base.text import did_you_mean, listed
from mbdkit.base.traced_numbers import named_number, recordable
from mbdkit.base.units import read_unit
from mbdkit.expressions.operations import FUNCTIONS, OPERATIONS
from mbdkit.expressions.program import MAX_DEPTH, Instruction, Program, depth_of, execute

if TYPE_CHECKING:
    import sympy

MAX_LENGTH = 10_000
MOST_TOLD = 6  #: Largest number of parameters whose values are stated in a message.
MAX_NESTING = 100
MAX_INTEGER_POWER = 1_000_000

Code = list[Instruction]  #: A program that is being compiled.

#: Name of the operation of each Python operator.
OPERATORS: dict[type[ast.operator], str] = {
    ast.Add: "add",
    ast.Sub: "sub",
    ast.Mult: "mul",
    ast.Div: "div",
    ast.Pow: "pow",
}

#: Hints on names that other software uses for the time.
TIME = dict.fromkeys(("time", "T"), " (the time is t)")

_QUOTED = r"""(["'])(?:(?!\1)[^\\]|\\["'\\])*\1"""


#: Longest text after a number in which a unit is looked for, and largest number of such texts.
LONGEST_UNIT, MOST_UNITS = 30, 20

#: Pattern of a number with a unit in an expression.
_WITH_UNIT = re.compile(
    r"(?<![\w.])(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?\s*((?!e\d)[A-Za-z%](?:[A-Za-z%*/^ ]*[A-Za-z%])?)"
)

#: Pattern of two factors without a sign between them.
_WITHOUT_SIGN = re.compile(r"(?<![\w.])[\d.]+(?!e[-+\d])[A-Za-z]|[\w.)]\s+\w|\)\w")


def _number_with_unit(match: re.Match[str]) -> str:
    """Return the beginning of a match that is a number with a unit; empty if there is none."""
    number, unit = match[0].removesuffix(match[1]), match[1][:LONGEST_UNIT]
    while unit:
        with suppress(SpecError):
            read_unit(unit)
            return number + unit
        unit = re.sub(r"[^A-Za-z%]*[A-Za-z%]+$", "", unit)
    return ""


class ExpressionError(SpecError):
    """An expression that is not valid."""


@dataclass(frozen=True)
class Expression:
    """A scalar function of time.

    Attributes
    ----------
    text
        Text of the expression as the user wrote it.
    program
        Program of the expression; the instruction ``t`` pushes the time.
    depth
        Largest number of operands on the stack, at most 32.
    """

    text: str
    program: Program
    depth: int

    @staticmethod
    def parse(text: str) -> Expression:
        """Parse a text.

        Raises
        ------
        SpecError
            For the first error; it contains the position in the text unless it concerns the text as a whole.
        """
        return _parse(text)

    def to_sympy(self) -> sympy.Expr:
        """Return the expression in SymPy, with the real symbol ``t``."""
        return symbolic(self.program, lambda operation, number: operation)


def symbolic(program: Program, name_of: Callable[[str, float], str]) -> sympy.Expr:
    """Return a program as a SymPy expression, with real symbols of these names for what it pushes."""
    import sympy as sp

    functions = {"abs": sp.Abs, "min": sp.Min, "max": sp.Max, "pow": sp.Pow}

    def step(operation: str, number: float, *operands: sympy.Expr) -> sympy.Expr:
        if operation == "const":
            return sp.Integer(int(number)) if number.is_integer() else sp.Float(number)
        if not operands:
            return sp.Symbol(name_of(operation, number), real=True)
        if operation == "powi":
            return operands[0] ** sp.Integer(int(number))
        own = OPERATIONS[operation]
        return (functions.get(operation) or (getattr(sp, operation) if own.is_function else own.number))(*operands)

    return execute(program, step)


@lru_cache(maxsize=4096)
def _parse(text: str) -> Expression:
    program = tuple(Compiler(text).program())
    depth = depth_of(program)
    if depth > MAX_DEPTH:
        raise SpecError(
            f"the expression needs {depth} intermediate values at once, more than {MAX_DEPTH}; use less nesting"
        )
    return Expression(text, program, depth)


class Compiler:
    """Compiler from the syntax tree of an expression to a postfix program; rejects nodes that are not on the whitelist.

    Parameters
    ----------
    text
        Text of the expression as the user wrote it.
    parameters
        Numbers that the expression may use by name.

    Attributes
    ----------
    wanted
        Description of an expression and its operands, for error messages.
    hint
        Text appended to the message of a syntax error.
    variable
        Name of the argument, which the instruction ``t`` pushes.
    error
        Class of the errors that refer to a position in the text.
    own_functions
        Functions that exist only in this context, with their numbers of arguments. If they have the same name as a
        function of all contexts, the number of arguments decides which of the two is meant.
    """

    wanted = "an expression of t, which consists of numbers, t, pi"
    hint = ""
    variable = "t"
    error = ExpressionError
    own_functions: ClassVar[Mapping[str, int]] = {}

    def __init__(self, text: str, parameters: Mapping[str, float] | None = None):
        self.parameters: Mapping[str, float] = parameters or {}
        if len(text) > MAX_LENGTH:
            raise SpecError(f"the expression has {len(text)} characters, more than {MAX_LENGTH}")
        self.source = " ".join(text.splitlines()).rstrip()
        self.shift = len(self.source) - len(self.source.lstrip())
        self.source = self.source.lstrip()
        if not self.source:
            raise SpecError(f"the expression is empty; it should be {self.wanted.partition(',')[0]}")
        for index, letter in enumerate(self.unquoted()):
            if not letter.isascii() or not letter.isprintable() or letter in "#\\;":
                self.refuse(f"the character {letter!r} is not part of an expression", index)

    def unquoted(self) -> str:
        """Return the text with quoted names replaced by blanks of the same length."""
        return re.sub(_QUOTED, lambda match: " " * len(match[0]), self.source)

    def program(self) -> Code:
        """Return the postfix program of the text; raises SpecError with the position of the first error."""
        return self.compile(self.tree(), 0)

    def tree(self) -> ast.expr:
        """Return the syntax tree of the text; raises SpecError if it cannot be parsed."""
        try:
            return ast.parse(self.source, mode="eval").body
        except SyntaxError as error:
            place = min(max((error.offset or 1) - 1, 0), len(self.source) - 1)
            for match in islice(_WITH_UNIT.finditer(self.source), MOST_UNITS):
                if quantity := _number_with_unit(match):
                    how = f"make '{quantity}' a parameter and write its name, or convert it to SI units"
                    self.refuse(f"numbers in expressions have no units; {how}", match.start())
            if factors := _WITHOUT_SIGN.search(self.unquoted()):
                self.refuse(f"the expression cannot be parsed: write * between factors{self.hint}", factors.end() - 1)
            self.refuse(f"the expression cannot be parsed ({error.msg}){self.hint}", place)
        except (RecursionError, MemoryError, ValueError):
            raise SpecError("the expression is too deeply nested") from None

    def refuse(self, message: str, place: ast.AST | int) -> NoReturn:
        """Raise an error of class `error` with the message and the position in the text."""
        column = place if isinstance(place, int) else getattr(place, "col_offset", 0)
        shown = self.source if len(self.source) <= 60 else self.source[max(column - 30, 0) :][:60] + "..."
        raise self.error(f"{message} (position {column + self.shift + 1} of '{shown}')")

    def segment(self, node: ast.expr) -> str:
        """Return the text of a node, at most 40 characters."""
        return (ast.get_source_segment(self.source, node) or self.source)[:40]

    def compile(self, node: ast.expr, nesting: int) -> Code:
        """Return the postfix program of a node."""
        if nesting > MAX_NESTING:
            self.refuse("the expression is too deeply nested", node)
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                if "_" in (text := self.segment(node)):
                    self.refuse(f"numbers have no underscores: write {text.replace('_', '')}", node)
                return self.constant(lambda: float(value), node)
            case ast.Name(id=name) if name == self.variable:
                return [("t", 0.0)]
            case ast.Name(id="pi"):
                return [("const", math.pi)]
            case ast.Name(id=name) if name in self.parameters:
                return [("const", self.parameters[name])]
            case ast.Name(id=name) if (number := named_number(name)) is not None:
                return [("const", number)]
            case ast.Name(id=name) if name in FUNCTIONS or name in self.own_functions:
                self.refuse(f"'{name}' is a function and needs its argument in parentheses", node)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.compile(operand, nesting + 1)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return self.apply("neg", [self.compile(operand, nesting + 1)], node)
            case ast.BinOp():
                return self.chain(node, nesting)
            case ast.Call():
                return self.call(node, nesting)
        return self.operand(node)

    def names(self) -> tuple[str, ...]:
        """Return the names of the variables that error messages list."""
        return (self.variable,)

    def operand(self, node: ast.expr) -> Code:
        """Return the program of an operand that depends on the context.

        This class rejects all of them with SpecError; subclasses accept some.
        """
        if isinstance(node, ast.Name):
            name = self.segment(node)
            known = [*self.names(), "pi", *FUNCTIONS, *self.parameters]
            hint = (TIME.get(name) if self.variable == "t" else "") or did_you_mean(name, known)
            hint = hint or f"; known: {listed([*self.names(), 'pi', *self.parameters])} and functions"
            self.refuse(f"unknown name '{name}'{hint}", node)
        if isinstance(node, ast.Compare):
            sides = f"{ast.unparse(node.left)} - ({ast.unparse(node.comparators[0])})"
            self.refuse(f"expressions have no comparisons; write the difference of both sides, {sides}", node)
        self.refuse(
            f"'{self.segment(node)}' is not part of {self.wanted}, + - * / **, "
            f"parentheses and the functions {', '.join(FUNCTIONS)}",
            node,
        )

    def chain(self, node: ast.BinOp, nesting: int) -> Code:
        """Compile a chain of left-associative operators without recursion, so a long sum does not count as nesting."""
        links = [node]
        while isinstance(links[-1].left, ast.BinOp):
            links.append(links[-1].left)
        program = self.compile(links[-1].left, nesting + 1)
        for link in reversed(links):
            if (operation := OPERATORS.get(type(link.op))) is None:
                hint = "; a power is written **" if isinstance(link.op, ast.BitXor) else ""
                self.refuse(f"only the operators + - * / ** can be used{hint}", link)
            program = self.apply(operation, [program, self.compile(link.right, nesting + 1)], link)
        return program

    def call(self, node: ast.Call, nesting: int) -> Code:
        """Compile a function call."""
        name = node.func.id if isinstance(node.func, ast.Name) else self.segment(node.func)
        function, count = self.own_functions.get(name), len(node.args)
        if function is not None and (count == function or name not in FUNCTIONS):
            if node.keywords or count != function:
                self.refuse(f"'{name}' takes {function} argument{'s' * (function > 1)}", node)
            return self.of_function(name, [self.compile(argument, nesting + 1) for argument in node.args], node)
        if not isinstance(node.func, ast.Name) or name not in FUNCTIONS:
            hint = did_you_mean(name, [*FUNCTIONS, *self.own_functions])
            self.refuse(f"'{name}' is not a function that can be used{hint}", node)
        operation = OPERATIONS.get(name)
        least = operation.arity if operation else 1
        takes_more = operation is not None and operation.takes_more
        if node.keywords or count < least or (count > least and not takes_more):
            wanted = f"{least} or more arguments" if takes_more else f"{least} argument{'s' * (least > 1)}"
            self.refuse(f"'{name}' takes {wanted}", node)
        program, *others = (self.compile(argument, nesting + 1) for argument in node.args)
        if name == "degrees":
            return self.apply("mul", [program, [("const", math.pi / 180.0)]], node)
        if not others:
            return self.apply(name, [program], node)
        for operand in others:
            program = self.apply(name, [program, operand], node)
        return program

    def of_function(self, name: str, arguments: list[Code], node: ast.Call) -> Code:
        """Return the program of one of `own_functions`."""
        raise NotImplementedError

    def apply(self, operation: str, operands: list[Code], node: ast.expr) -> Code:
        """Append `operation` to the programs of its operands, or evaluate it if all of them are constants."""
        if all(len(operand) == 1 and operand[0][0] == "const" for operand in operands):
            compute = recordable(OPERATIONS[operation].number)
            return self.constant(lambda: compute(*(operand[0][1] for operand in operands)), node)
        program = operands[0]
        if operation == "pow" and operands[1][0][0] == "const" and len(operands[1]) == 1:
            exponent = operands[1][0][1]
            if exponent.is_integer():
                if abs(exponent) > MAX_INTEGER_POWER:
                    self.refuse(f"the exponent is larger than {MAX_INTEGER_POWER}", node)
                program.append(("powi", exponent))
                return program
        for operand in operands[1:]:
            program.extend(operand)
        program.append((operation, 0.0))
        return program

    def constant(self, compute: Callable[[], float], node: ast.expr) -> Code:
        """Return the program of a constant, which is a number in the text or the result of an operation on
        constants.
        """
        try:
            value = compute()
        except ZeroDivisionError:
            self.refuse(f"'{self.segment(node)}' divides by zero{self.given(node)}, so it is not a finite number", node)
        except (ArithmeticError, ValueError):
            value = math.nan
        if not abs(value) < math.inf:
            self.refuse(f"'{self.segment(node)}' is not a finite number{self.given(node)}", node)
        return [("const", value)]

    def given(self, node: ast.expr) -> str:
        """Return the values of the parameters that a node contains, as a part of a message; empty if there are none."""
        names = dict.fromkeys(part.id for part in ast.walk(node) if isinstance(part, ast.Name))
        values = [f"{name} = {self.parameters[name]:g}" for name in names if name in self.parameters]
        return f" for {listed(values[:MOST_TOLD], 'and')}" if values else ""
