#pragma once
// A state as numbers, bit-exact: written by one process and read by the next of the same program.
// Not for files that outlive a program. One description of a state serves both directions.

#include <bit>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "common/geometry/se3.hpp"

namespace zloam {

class StateBits {
 public:
  using Words = std::vector<std::uint64_t>;

  /// For writing.
  StateBits() = default;
  /// For reading.
  explicit StateBits(std::span<const std::uint64_t> words) : reads_(true), in_(words) {}

  /// After reading: the words held exactly the values read.
  bool complete() const { return !short_ && in_.empty(); }
  Words take() { return std::move(out_); }

  template <class... Values>
  void operator()(Values&... values) {
    (visit(values), ...);
  }

 private:
  void word(std::uint64_t& w) {
    if (!reads_) {
      out_.push_back(w);
    } else if (in_.empty()) {
      short_ = true;
    } else {
      w = in_.front();
      in_ = in_.subspan(1);
    }
  }
  void visit(double& value) {
    auto w = std::bit_cast<std::uint64_t>(value);
    word(w);
    value = std::bit_cast<double>(w);
  }
  template <class T>
  requires(std::is_integral_v<T> || std::is_enum_v<T>) void visit(T& value) {
    auto w = static_cast<std::uint64_t>(value);
    word(w);
    value = static_cast<T>(w);
  }
  template <int kRows, int kColumns>
  void visit(Eigen::Matrix<double, kRows, kColumns>& matrix) {
    for (double& value : matrix.reshaped()) visit(value);
  }
  void visit(Pose& pose) {
    for (double& value : pose.matrix().reshaped()) visit(value);
  }
  template <class T>
  void visit(std::optional<T>& value) {
    bool has = value.has_value();
    visit(has);
    // Not in place: clang 14 treats a class nested in another as not constructible there.
    if (reads_) value = has ? std::optional<T>(T{}) : std::nullopt;
    if (value) visit(*value);
  }
  template <class A, class B>
  void visit(std::pair<A, B>& values) {
    visit(values.first);
    visit(values.second);
  }
  template <class T>
  void visit(std::deque<T>& values) {
    std::uint64_t count = values.size();
    word(count);
    // Each value is a word at least.
    if (reads_ && count > in_.size()) short_ = true;
    if (short_) return;
    if (reads_) values.resize(count);
    for (T& value : values) visit(value);
  }
  template <class T>
  void visit(std::map<std::uint64_t, T>& values) {
    std::deque<std::uint64_t> keys;
    std::deque<T> items;
    for (auto& [key, value] : values) {
      keys.push_back(key);
      items.push_back(value);
    }
    visit(keys);
    visit(items);
    if (!reads_ || short_ || keys.size() != items.size()) return;
    values.clear();
    for (std::size_t i = 0; i < keys.size(); ++i) values.emplace(keys[i], items[i]);
  }
  template <class T>
  requires requires(T& value, StateBits& bits) { value.each(bits); }
  void visit(T& value) { value.each(*this); }

  bool reads_ = false;
  bool short_ = false;
  std::span<const std::uint64_t> in_;
  Words out_;
};

}  // namespace zloam
