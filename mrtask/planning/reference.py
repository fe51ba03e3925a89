"""Pass named tuples to a kernel's parts by reference.

By default, numba passes a named tuple as the numbers that make up its arrays, and takes it apart and rebuilds it at
each call. With two dozen arrays, that is half of the code to be compiled.
"""

from typing import Any

from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, models, register_model


class _Reference(types.Type):
    """The type of a pointer to a named tuple."""

    def __init__(self, to: Any) -> None:
        self.to = to
        super().__init__(name=f"reference to {to}")

    def field(self, name: str) -> tuple[int, types.Type]:
        """Return a field's index and type. The type is a reference if the field is a named tuple."""
        index = self.to.fields.index(name)
        kind = self.to[index]
        return index, _Reference(kind) if isinstance(kind, types.BaseNamedTuple) else kind


@register_model(_Reference)
class _ReferenceModel(models.PrimitiveModel):
    def __init__(self, manager: Any, reference: _Reference) -> None:
        super().__init__(manager, reference, manager.lookup(reference.to).get_value_type().as_pointer())


@infer_getattr
class _ReferenceFields(AttributeTemplate):
    key = _Reference

    def generic_resolve(self, reference: _Reference, name: str) -> Any:  # type: ignore[override]
        return reference.field(name)[1] if name in reference.to.fields else None


@lower_getattr_generic(_Reference)
def _field(context: Any, builder: Any, reference: _Reference, pointer: Any, name: str) -> Any:
    index, kind = reference.field(name)
    place = cgutils.gep_inbounds(builder, pointer, 0, index)
    return place if isinstance(kind, _Reference) else builder.load(place)


def _by_reference(context: Any, value: types.Type) -> Any:
    if not isinstance(value, types.BaseNamedTuple):
        return value(value), lambda context, builder, signature, arguments: arguments[0]
    return _Reference(value)(value), lambda context, builder, signature, arguments: cgutils.alloca_once_value(
        builder, arguments[0]
    )


by_reference: Any = intrinsic(_by_reference)
"""Return a named tuple as a kernel passes it to its parts, which read its fields as usual. None stays None."""
