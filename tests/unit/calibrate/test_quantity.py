"""Parameters and user functions as quantities."""

import numpy as np
import pytest
from problems import plain_parameters, sloppy_springs

from identknee.calibrate.problem import ParameterQuantity, UserQuantity

# Central differences with a step of 6e-6: its square.
DIFFERENCES = 1e-9


def test_a_parameter_is_itself() -> None:
    parameters = sloppy_springs().parameters
    strain = ParameterQuantity(parameters=parameters, name="LCL.reference_strain_pct")
    value, gradient = strain.evaluate(np.arange(8.0))
    assert value == 6.0
    np.testing.assert_array_equal(gradient, np.eye(8)[6])
    assert strain.unit == "%"
    assert ParameterQuantity(parameters=parameters, name="ACL.stiffness_kN").unit == "kN"


def test_an_unknown_parameter_is_refused() -> None:
    with pytest.raises(ValueError, match="parameter 'x9'"):
        ParameterQuantity(parameters=plain_parameters(2), name="x9")


def test_a_function_gets_its_gradient_by_differences() -> None:
    product = UserQuantity(name="product", unit="", function=lambda x: float(x[0] * x[1] ** 2))
    value, gradient = product.evaluate(np.array([2.0, 3.0]))
    assert value == 18.0
    np.testing.assert_allclose(gradient, [9.0, 12.0], rtol=DIFFERENCES)


def test_a_gradient_given_is_used() -> None:
    square = UserQuantity(
        name="square", unit="", function=lambda x: float(x[0] ** 2), gradient=lambda x: 2 * x
    )
    np.testing.assert_array_equal(square.evaluate(np.array([3.0]))[1], [6.0])


def test_a_side_without_a_value_is_left_out() -> None:
    def root(x: np.ndarray) -> float:
        return float(np.sqrt(x[0])) if x[0] >= 1.0 else np.nan

    value, gradient = UserQuantity(name="root", unit="", function=root).evaluate(np.ones(1))
    assert value == 1.0
    # A one-sided difference: its own step.
    assert gradient[0] == pytest.approx(0.5, rel=1e-5)


def test_no_value_is_no_number() -> None:
    nothing = UserQuantity(name="nothing", unit="", function=lambda _: np.inf)
    value, gradient = nothing.evaluate(np.zeros(2))
    assert np.isnan(value)
    assert np.isnan(gradient).all()
