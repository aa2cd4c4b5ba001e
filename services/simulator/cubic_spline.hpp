#pragma once
// Natural cubic splines with equally spaced knots: twice continuously differentiable, evaluated in
// constant time (Press et al., Numerical Recipes, 3rd ed., section 3.3).

#include <Eigen/Core>
#include <vector>

namespace zloam::simulator {

template <int Channels>
class CubicSpline {
 public:
  using Value = Eigen::Matrix<double, Channels, 1>;

  struct Sample {
    Value value;
    Value first;   ///< derivative per unit of the parameter
    Value second;  ///< second derivative
  };

  CubicSpline() = default;

  /// The spline through values[i] at parameter i * step. At least two values.
  CubicSpline(std::vector<Value> values, double step)
      : step_(step), values_(std::move(values)), curvature_(values_.size(), Value::Zero()) {
    const std::size_t n = values_.size();
    std::vector<double> upper(n, 0.0);
    for (std::size_t i = 1; i + 1 < n; ++i) {  // forward elimination of the tridiagonal system
      const double pivot = 0.5 * upper[i - 1] + 2.0;
      upper[i] = -0.5 / pivot;
      const Value bend =
          (values_[i + 1] - 2.0 * values_[i] + values_[i - 1]) * (3.0 / (step_ * step_));
      curvature_[i] = (bend - 0.5 * curvature_[i - 1]) / pivot;
    }
    for (std::size_t i = n - 1; i-- > 1;) {
      curvature_[i] += upper[i] * curvature_[i + 1];
    }
  }

  double end() const { return step_ * static_cast<double>(values_.size() - 1); }

  /// Outside [0, end()] the value is that of the nearest end, and the derivatives are 0.
  Sample at(double parameter) const {
    if (parameter <= 0.0) {
      return {values_.front(), Value::Zero(), Value::Zero()};
    }
    if (parameter >= end()) {
      return {values_.back(), Value::Zero(), Value::Zero()};
    }
    const double position = parameter / step_;
    const auto i = static_cast<std::size_t>(position);
    const double b = position - static_cast<double>(i);
    const double a = 1.0 - b;
    const Value& c0 = curvature_[i];
    const Value& c1 = curvature_[i + 1];
    const double h = step_;
    return {a * values_[i] + b * values_[i + 1] +
                ((a * a * a - a) * c0 + (b * b * b - b) * c1) * (h * h / 6.0),
            (values_[i + 1] - values_[i]) / h +
                ((3.0 * b * b - 1.0) * c1 - (3.0 * a * a - 1.0) * c0) * (h / 6.0),
            a * c0 + b * c1};
  }

 private:
  double step_ = 1.0;
  std::vector<Value> values_;
  std::vector<Value> curvature_;
};

}  // namespace zloam::simulator
