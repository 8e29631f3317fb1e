"""Comparisons of eight elements of a row at once; the results are the bits of a byte, the lowest first.

numba stores each result of a comparison as a byte, and packing these into bits takes as long as comparing. Processors
return the signs of a whole register in one instruction, which LLVM uses when the bits of eight results are requested.
Arrays whose elements are not contiguous are rejected when the caller is compiled. The caller must ensure that all eight
elements lie inside the array.
"""

from __future__ import annotations

from typing import Any

from harris_perception.core.image.compiled import TypingError, cgutils, intrinsic, types

ir: Any = cgutils.ir  # of llvmlite, a dependency of numba
_LANES = 8


def _vector(context: Any, builder: Any, kind: Any, array: Any, first: Any) -> Any:
    """Load the elements of an array of this kind, starting at ``first``."""
    element = context.get_data_type(kind.dtype)
    data = context.make_array(kind)(context, builder, array).data
    place = builder.bitcast(cgutils.gep(builder, data, first), ir.VectorType(element, _LANES).as_pointer())
    return builder.load(place, align=context.get_abi_alignment(element))


def _repeated(builder: Any, value: Any) -> Any:
    vector = ir.Constant(ir.VectorType(value.type, _LANES), ir.Undefined)
    for i in range(_LANES):
        vector = builder.insert_element(vector, value, ir.Constant(ir.IntType(32), i))
    return vector


def _bits(builder: Any, sign: str, one: Any, other: Any) -> Any:
    """Return for which elements ``one sign other`` is true; false for NaN."""
    compare = builder.icmp_signed if isinstance(one.type.element, ir.IntType) else builder.fcmp_ordered
    return builder.bitcast(compare(sign, one, other), ir.IntType(_LANES))


def _magnitude(builder: Any, vector: Any) -> Any:
    if isinstance(vector.type.element, ir.IntType):
        zero = ir.Constant(vector.type, [0] * _LANES)
        return builder.select(builder.icmp_signed("<", vector, zero), builder.neg(vector), vector)
    kind = ir.FunctionType(vector.type, [vector.type])
    absolute = cgutils.get_or_insert_function(
        builder.module, kind, f"llvm.fabs.v{_LANES}{vector.type.element.intrinsic_name}"
    )
    return builder.call(absolute, [vector])


def _refuse_gaps(*kinds: Any) -> None:
    for kind in kinds:
        if kind.ndim != 1 or kind.layout != "C":
            raise TypingError(f"eight elements side by side are compared, which {kind} may not have")


def _of_arrays(sign: str, of: Any = lambda builder, vector: vector) -> Any:
    @intrinsic  # type: ignore[untyped-decorator, unused-ignore]
    def compare(typing: Any, one: Any, first: Any, other: Any, second: Any) -> Any:
        _refuse_gaps(one, other)

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            kinds = signature.args
            vectors = (of(builder, _vector(context, builder, kinds[i], values[i], values[i + 1])) for i in (0, 2))
            return _bits(builder, sign, *vectors)

        return types.uint8(one, first, other, second), generate

    return compare


def _of_value(sign: str) -> Any:
    @intrinsic  # type: ignore[untyped-decorator, unused-ignore]
    def compare(typing: Any, one: Any, first: Any, value: Any) -> Any:
        _refuse_gaps(one)

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            vector = _vector(context, builder, signature.args[0], *values[:2])
            return _bits(builder, sign, vector, _repeated(builder, values[2]))

        return types.uint8(one, first, one.dtype), generate

    return compare


def _of_chosen(sign: str) -> Any:
    @intrinsic  # type: ignore[untyped-decorator, unused-ignore]
    def compare(typing: Any, bits: Any, one: Any, first: Any, other: Any, second: Any, than: Any, third: Any) -> Any:
        _refuse_gaps(one, other, than)

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            choice = builder.bitcast(values[0], ir.VectorType(ir.IntType(1), _LANES))
            ones, others, thans = (
                _vector(context, builder, signature.args[i], values[i], values[i + 1]) for i in (1, 3, 5)
            )
            return _bits(builder, sign, builder.select(choice, ones, others), thans)

        return types.uint8(types.uint8, one, first, other, second, than, third), generate

    return compare


exceed = _of_arrays(">")
"""``exceed(one, first, other, second)``: where one[first + i] > other[second + i]; arrays of one dtype."""

reach = _of_arrays(">=")
"""``reach(one, first, other, second)``: where one[first + i] >= other[second + i]."""

reach_in_magnitude = _of_arrays(">=", _magnitude)
"""``reach_in_magnitude(one, first, other, second)``: where abs(one[first + i]) >= abs(other[second + i])."""

chosen_exceed = _of_chosen(">")
"""``chosen_exceed(bits, one, first, other, second, than, third)``: as ``exceed``, of ``one`` where a bit is set."""

chosen_reach = _of_chosen(">=")
"""``chosen_reach(bits, one, first, other, second, than, third)``: as ``reach``, of ``one`` where a bit is set."""

above = _of_value(">")
"""``above(one, first, value)``: where one[first + i] > value, which is of the array's dtype."""

below = _of_value("<")
"""``below(one, first, value)``: where one[first + i] < value."""
