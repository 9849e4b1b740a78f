"""Instructions on vectors of eight, intrinsics made of them, and sizes as types."""

# Types of Numba are called to make signatures.
# pyright: reportCallIssue=false

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    models,
    register_model,
    unbox,
)

LANES = 8

REAL, WORD, INDEX = ir.DoubleType(), ir.IntType(64), ir.IntType(32)
VECTOR, WORDS = ir.VectorType(REAL, LANES), ir.VectorType(WORD, LANES)


class Lanes(types.Type):
    """The type of a vector with one float per scenario; a plain number is converted to one."""

    def __init__(self) -> None:
        super().__init__(name="EightScenarios")

    def can_convert_from(self, typingctx: Any, other: Any) -> Any:
        return Conversion.safe if other == types.float64 else None


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, VECTOR)


EIGHT = Lanes()


class LaneSizes(types.Type):
    """The type of an object whose fields are, in compiled code, tuples of so many zeros.

    Only their lengths matter (`like`), and they are in the type, so that the object is empty:
    real tuples would be converted entry by entry and passed at every call, which takes seconds to
    compile.
    """

    def __init__(self, fields: dict[str, int]) -> None:
        self.fields = fields
        super().__init__(name=f"Sizes({', '.join(f'{n}={k}' for n, k in fields.items() if k)})")


@infer_getattr
class _Fields(AttributeTemplate):
    key = LaneSizes

    def generic_resolve(self, kind: Any, name: str) -> Any:
        if name in kind.fields:
            return types.UniTuple(types.float64, kind.fields[name])
        return None


@lower_getattr_generic(LaneSizes)
def _zeros(context: Any, builder: Any, kind: Any, value: Any, name: str) -> Any:
    return context.get_constant_null(types.UniTuple(types.float64, kind.fields[name]))


class KnownNumbers:
    """Numbers that are constants in compiled code, so that loops over them are unrolled."""

    def __init__(self, numbers: dict[str, int]) -> None:
        self._numba_type_ = KnownNumbersType(numbers)

    def __iter__(self) -> Iterator[int]:
        return iter(self._numba_type_.numbers.values())


class KnownNumbersType(types.Type):
    """The type of `KnownNumbers`, with the numbers as attributes."""

    def __init__(self, numbers: dict[str, int]) -> None:
        self.numbers = numbers
        super().__init__(name=f"KnownNumbers({', '.join(f'{n}={k}' for n, k in numbers.items())})")


for _type in (LaneSizes, KnownNumbersType):  # objects without data
    register_model(_type)(models.OpaqueModel)
    unbox(_type)(lambda kind, given, c: NativeValue(c.context.get_dummy_value()))


@infer_getattr
class _Numbers(AttributeTemplate):
    key = KnownNumbersType

    def generic_resolve(self, kind: Any, name: str) -> Any:
        return types.intp if name in kind.numbers else None


@lower_getattr_generic(KnownNumbersType)
def _number(context: Any, builder: Any, kind: Any, value: Any, name: str) -> Any:
    return ir.Constant(WORD, kind.numbers[name])


def vectors(count: int) -> types.UniTuple:
    return types.UniTuple(EIGHT, count)


def same_for_all(builder: Any, kind: Any, value: Any) -> Any:
    """A vector of this type with one value for all scenarios."""
    undefined = ir.Constant(kind, ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(INDEX, 0))
    zeros = ir.Constant(ir.VectorType(INDEX, LANES), [0] * LANES)
    return builder.shuffle_vector(first, undefined, zeros)


class Code:
    """Instructions on vectors, for intrinsics."""

    def __init__(self, context: Any, builder: Any) -> None:
        self.context, self.builder = context, builder

    def place(self, kind: Any, array: Any, index: Any, shift: int) -> Any:
        data = self.context.make_array(kind)(self.context, self.builder, array).data
        return self.builder.gep(data, [self.builder.add(index, ir.Constant(WORD, shift))])

    def vector(self, kind: Any, array: Any, index: Any, shift: int) -> Any:
        place = self.place(kind, array, index, shift)
        loaded = self.builder.load(self.builder.bitcast(place, VECTOR.as_pointer()))
        loaded.align = 8
        return loaded

    def same(self, number: Any) -> Any:
        return same_for_all(self.builder, VECTOR, number)

    def load_same(self, kind: Any, array: Any, index: Any, shift: int) -> Any:
        return self.same(self.builder.load(self.place(kind, array, index, shift)))

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        kind = ir.FunctionType(VECTOR, [VECTOR] * 3)
        name = f"llvm.fma.v{LANES}f64"
        return self.builder.call(self.builder.module.declare_intrinsic(name, fnty=kind), [a, b, c])

    def words_like(self, value: Any) -> Any:
        """The type of the bits of a float or a vector."""
        return WORDS if value.type == VECTOR else WORD

    def bits(self, kind: Any, value: int) -> Any:
        return ir.Constant(kind, [value] * LANES if kind == WORDS else value)

    def number(self, kind: Any, value: float) -> Any:
        return ir.Constant(kind, [value] * LANES if kind == VECTOR else value)

    def larger(self, a: Any, b: Any) -> Any:
        return self.builder.select(self.builder.fcmp_ordered(">", a, b), a, b)

    def smaller(self, a: Any, b: Any) -> Any:
        return self.builder.select(self.builder.fcmp_ordered("<", a, b), a, b)


Work = Callable[..., Any]


def make_code(signature: Any, work: Work) -> tuple[Any, Callable[..., Any]]:
    """The code of an intrinsic: `work` gets tuples of vectors as lists, and returns such a list.

    Arrays are passed as (type, array).
    """

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        unpacked = []
        for kind, value in zip(signature.args, arguments, strict=True):
            if isinstance(kind, types.UniTuple):
                unpacked.append(cgutils.unpack_tuple(builder, value, len(kind)))
            elif isinstance(kind, types.Array):
                unpacked.append((kind, value))
            else:
                unpacked.append(value)
        result = work(Code(context, builder), *unpacked)
        if signature.return_type is types.void:
            return context.get_dummy_value()
        if signature.return_type is types.float64:
            return result
        return context.make_tuple(builder, signature.return_type, result)

    return signature, code
