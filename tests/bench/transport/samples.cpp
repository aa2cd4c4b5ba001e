#include "samples.hpp"

#include <array>
#include <cstdio>
#include <fstream>

#include "common/runtime/parameters.hpp"

namespace zloam::bench {

std::string json_list(const std::vector<double>& samples_ms) {
  std::string text = "[";
  for (const double sample : samples_ms) {
    std::array<char, 32> number{};
    std::snprintf(number.data(), number.size(), "%s%.3f", text.size() > 1 ? "," : "", sample);
    text += number.data();
  }
  return text + "]";
}

void write_report(const std::string& path, const std::map<std::string, std::string>& values) {
  std::ofstream out(path);
  const char* separator = "{";
  for (const auto& [name, value] : values) {
    out << separator << "\"" << name << "\":" << value;
    separator = ",";
  }
  out << "}\n";
  out.close();
  if (!out) throw runtime::IoError("can't write " + path);
}

}  // namespace zloam::bench
