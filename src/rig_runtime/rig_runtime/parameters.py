"""ROS parameters from configuration dataclasses: declared once, described, bounded, read-only unless declared live."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, ParameterType, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from shared_control.parameters import Declaration, ParameterError, build, declarations, shown

T = TypeVar("T")

_TYPES = {
    "bool": ParameterType.PARAMETER_BOOL,
    "int": ParameterType.PARAMETER_INTEGER,
    "float": ParameterType.PARAMETER_DOUBLE,
    "str": ParameterType.PARAMETER_STRING,
    "bool array": ParameterType.PARAMETER_BOOL_ARRAY,
    "int array": ParameterType.PARAMETER_INTEGER_ARRAY,
    "float array": ParameterType.PARAMETER_DOUBLE_ARRAY,
    "str array": ParameterType.PARAMETER_STRING_ARRAY,
}

_PARAMETER_TYPES = {
    "bool array": Parameter.Type.BOOL_ARRAY,
    "int array": Parameter.Type.INTEGER_ARRAY,
    "float array": Parameter.Type.DOUBLE_ARRAY,
    "str array": Parameter.Type.STRING_ARRAY,
}

#: Parameters of rclpy itself, which it declares when it needs them.
_FOREIGN = ("qos_overrides.", "use_sim_time", "start_type_description_service")

_INT64_MAX = 2**63 - 1
_INFINITY = float("inf")


def descriptor(declaration: Declaration) -> ParameterDescriptor:
    """What `ros2 param describe` and rqt show of a declared parameter."""
    unit = f" [{declaration.unit}]" if declaration.unit else ""
    message = ParameterDescriptor(
        name=declaration.name,
        type=_TYPES[declaration.kind],
        description=declaration.description + unit,
        additional_constraints=declaration.allowed(),
        read_only=not declaration.live,
    )
    if declaration.ge is not None or declaration.le is not None:
        low, high = declaration.ge, declaration.le
        if declaration.kind == "float":
            message.floating_point_range = [
                FloatingPointRange(
                    from_value=-_INFINITY if low is None else float(low),
                    to_value=_INFINITY if high is None else float(high),
                )
            ]
        elif declaration.kind == "int":
            message.integer_range = [
                IntegerRange(
                    from_value=-_INT64_MAX if low is None else int(low),
                    to_value=_INT64_MAX if high is None else int(high),
                )
            ]
    return message


def _declare_empty(node: Node, declaration: Declaration) -> Any:
    """Declare an array whose default is empty; return its value, which an override may have given.

    rclpy takes an empty list for one of bytes, so the type comes first, then the value, then what forbids a change.
    Without a value the parameter would empty the answer to every request for all values (`ros2 param dump`).
    """
    kind = _PARAMETER_TYPES[declaration.kind]
    described = descriptor(declaration)
    described.read_only = False
    node.declare_parameter(declaration.name, kind, described)
    if node.get_parameter_or(declaration.name).value is None:
        node.set_parameters([Parameter(declaration.name, kind, [])])
    node.set_descriptor(declaration.name, descriptor(declaration))
    return node.get_parameter(declaration.name).value


def refuse_unknown_types(serve: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """rclpy's callback of `set_parameters`, which would end the node at a value of a type that there is not."""

    def refuse(request: Any, response: Any) -> Any:
        unknown = [given for given in request.parameters if given.value.type > ParameterType.PARAMETER_STRING_ARRAY]
        if not unknown:
            return serve(request, response)
        reason = f"{shown(unknown[0].name)}: there is no type {unknown[0].value.type}; nothing was changed"
        result = SetParametersResult(successful=False, reason=reason)
        if hasattr(response, "results"):
            response.results = [result] * len(request.parameters)
        else:
            response.result = result
        return response

    return refuse


class NodeParameters:
    """The parameters of a node, declared from its configuration dataclasses.

    Raises
    ------
    ParameterError: an override has a wrong type or lies outside its bounds, or names no declared parameter.
    """

    def __init__(self, node: Node, *configurations: type) -> None:
        self._configurations = configurations
        self._declarations: dict[str, Declaration] = {}
        self._values: dict[str, Any] = {}
        self._listener: Callable[[], None] | None = None
        where = f"node {node.get_fully_qualified_name()}"
        for configuration in configurations:
            for declaration in declarations(configuration):
                self._declarations[declaration.name] = declaration
                self._values[declaration.name] = self._declare(node, declaration, where)
        self._refuse_unknown(node, where)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._store)

    def _refuse_unknown(self, node: Node, where: str) -> None:
        # ROS ignores an override that nobody declared, so a misspelt key would silently mean the default.
        for name in node._parameter_overrides:  # noqa: SLF001 rclpy offers no other way
            if not node.has_parameter(name) and not name.startswith(_FOREIGN):
                near = difflib.get_close_matches(name, self._declarations, n=1)
                hint = f"did you mean {near[0]}?" if near else "known here: " + ", ".join(self._declarations)
                raise ParameterError(f"{where}: unknown parameter {name}; {hint}")

    def _declare(self, node: Node, declaration: Declaration, where: str) -> Any:
        default: Any = list(declaration.default) if declaration.is_array else declaration.default
        try:
            if declaration.is_array and not default:
                value = _declare_empty(node, declaration)
            else:
                value = node.declare_parameter(declaration.name, default, descriptor(declaration)).value
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            given = node._parameter_overrides.get(declaration.name)  # noqa: SLF001
            shown = f" = {given.value!r}" if given is not None else ""
            raise ParameterError(
                f"{where}: {declaration.name}{shown} is not allowed; it must be {declaration.allowed()}"
            ) from error
        try:
            return declaration.check(value)
        except ParameterError as error:
            raise ParameterError(f"{where}: {error}") from None

    def get(self, configuration: type[T]) -> T:
        """The present values as an instance of one of the configuration dataclasses."""
        names = [declaration.name for declaration in declarations(configuration)]
        return build(configuration, {name: self._values[name] for name in names})

    def on_change(self, listener: Callable[[], None]) -> None:
        """Call `listener` after live parameters have changed."""
        self._listener = listener

    def _check(self, parameters: Sequence[Parameter[Any]]) -> SetParametersResult:
        for parameter in parameters:
            declaration = self._declarations.get(parameter.name)
            if declaration is None:
                continue
            try:
                declaration.check(parameter.value)
            except ParameterError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _store(self, parameters: Sequence[Parameter[Any]]) -> None:
        for parameter in parameters:
            declaration = self._declarations.get(parameter.name)
            if declaration is not None:
                self._values[parameter.name] = declaration.check(parameter.value)
        if self._listener is not None:
            self._listener()
