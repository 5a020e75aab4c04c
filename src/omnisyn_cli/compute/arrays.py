"""New arrays in kernels. They are numpy's, but numba compiles ``np.empty`` and its kin anew for all types and options.

That takes a twentieth of a second each, which is felt on the first run.
"""

from typing import Any

from numba import types
from numba.core import cgutils
from numba.core.typing.npydecl import parse_dtype, parse_shape
from numba.extending import intrinsic
from numba.np import arrayobj


def _array_of(shape: Any, dtype: Any) -> Any:
    """Numba's type of a new array."""
    return types.Array(parse_dtype(dtype), parse_shape(shape), "C")


def _allocated(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    sizes = arrayobj._parse_shape(context, builder, signature.args[0], arguments[0])
    return arrayobj._empty_nd_impl(context, builder, signature.return_type, sizes)


@intrinsic
def empty(typing_context: Any, shape: Any, dtype: Any) -> Any:
    """:func:`numpy.empty`, in kernels only."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _allocated(context, builder, signature, arguments)._getvalue()

    return _array_of(shape, dtype)(shape, dtype), generate


@intrinsic
def zeros(typing_context: Any, shape: Any, dtype: Any) -> Any:
    """:func:`numpy.zeros`, in kernels only."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = _allocated(context, builder, signature, arguments)
        cgutils.memset(builder, array.data, builder.mul(array.itemsize, array.nitems), 0)
        return array._getvalue()

    return _array_of(shape, dtype)(shape, dtype), generate
