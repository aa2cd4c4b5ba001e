#pragma once
// Names of models, compared without case, spaces and punctuation.

#include <cctype>
#include <string>
#include <string_view>

namespace zloam::driver {

/// "VLP-16" and "vlp 16" are "vlp16".
inline std::string plain_label(std::string_view label) {
  std::string plain;
  for (const char c : label) {
    if (std::isalnum(static_cast<unsigned char>(c)) != 0) {
      plain.push_back(static_cast<char>(std::tolower(static_cast<unsigned char>(c))));
    }
  }
  return plain;
}

}  // namespace zloam::driver
