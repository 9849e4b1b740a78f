"""Instructions on vectors of eight, how an intrinsic is made of them, and sizes as a type."""

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
    """The type of one float of each of eight scenarios; a number is the same for all of them."""

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
    """The type of an object whose fields compiled code reads as tuples of so many numbers.

    Only the lengths are there, so it takes no room: tuples of numbers would be unpacked from
    Python's one by one, and handed on at every call, which costs seconds of compiling.
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
    """Numbers that compiled code knows as constants, so that it unrolls loops over them."""

    def __init__(self, numbers: dict[str, int]) -> None:
        self._numba_type_ = KnownNumbersType(numbers)

    def __iter__(self) -> Iterator[int]:
        return iter(self._numba_type_.numbers.values())


class KnownNumbersType(types.Type):
    """The type of `KnownNumbers`; an attribute is one of the numbers."""

    def __init__(self, numbers: dict[str, int]) -> None:
        self.numbers = numbers
        super().__init__(name=f"KnownNumbers({', '.join(f'{n}={k}' for n, k in numbers.items())})")


for _type in (LaneSizes, KnownNumbersType):  # all is in the type, so that they take no room
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
    """A vector of this kind with one value for every scenario."""
    undefined = ir.Constant(kind, ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(INDEX, 0))
    zeros = ir.Constant(ir.VectorType(INDEX, LANES), [0] * LANES)
    return builder.shuffle_vector(first, undefined, zeros)


class Code:
    """Instructions on vectors, for the intrinsics below."""

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
        """One number for every scenario."""
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
    """The code of an intrinsic: `work` gets every tuple of vectors unpacked, and its result packed.

    Arrays come as (kind, array), so that they can be read.
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
