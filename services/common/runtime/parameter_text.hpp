#pragma once
// Conversions between configuration text and values that parameters of all types share.

#include <cstdint>
#include <string>
#include <vector>

#include "common/runtime/parameters.hpp"

namespace zloam::runtime {

/// Type of a parameter that takes any text on the command line, unchanged.
inline constexpr const char* kTextType = "text";

/// The range in words.
std::string range_text(Range range);

/// Sets the value when the whole text is a number within the range; returns the error, or an empty
/// text.
std::string set_double(const std::string& text, Range range, double* value);
std::string set_integer(const std::string& text, Range range, std::int64_t* value);

std::string join(const std::vector<std::string>& items);

/// A value as shown in an error.
std::string shown(const RawValue& value);

}  // namespace zloam::runtime
