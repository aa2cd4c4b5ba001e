// The types a parameter can have: how each is read, and how it is written as JSON.

#include <algorithm>
#include <charconv>
#include <nlohmann/json.hpp>

#include "common/runtime/parameter_text.hpp"
#include "common/runtime/parameters.hpp"

namespace zloam::runtime {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kScalarWanted = "a single value is expected";

template <class T, std::size_t N>
std::string set_triple(const RawValue& value, std::array<T, N>* out,
                       const std::function<std::string(const std::string&, T*)>& set) {
  if (value.shape != RawValue::Shape::kList || value.items.size() != N) {
    return "a list of " + std::to_string(N) + " numbers is expected";
  }
  std::array<T, N> parsed{};
  for (std::size_t i = 0; i < N; ++i) {
    if (std::string error = set(value.items[i], &parsed[i]); !error.empty()) return error;
  }
  *out = parsed;
  return {};
}

}  // namespace

Parameters::Added Parameters::add(const std::string& key, bool* field, const std::string& doc,
                                  Effect effect) {
  const auto set = [field](const RawValue& value) -> std::string {
    if (value.shape != RawValue::Shape::kScalar) return kScalarWanted;
    if (value.items[0] != "true" && value.items[0] != "false") return "true or false is expected";
    *field = value.items[0] == "true";
    return {};
  };
  return add_entry(key, "bool", "", "true or false", doc, effect, set,
                   [field] { return std::string(*field ? "true" : "false"); });
}

Parameters::Added Parameters::add(const std::string& key, double* field, Range range,
                                  const std::string& unit, const std::string& doc, Effect effect) {
  const auto set = [field, range](const RawValue& value) -> std::string {
    if (value.shape != RawValue::Shape::kScalar) return kScalarWanted;
    return set_double(value.items[0], range, field);
  };
  return add_entry(key, "number", unit, range_text(range), doc, effect, set,
                   [field] { return Json(*field).dump(); });
}

Parameters::Added Parameters::add(const std::string& key, float* field, Range range,
                                  const std::string& unit, const std::string& doc, Effect effect) {
  const auto set = [field, range](const RawValue& value) -> std::string {
    if (value.shape != RawValue::Shape::kScalar) return kScalarWanted;
    double parsed = 0.0;
    std::string error = set_double(value.items[0], range, &parsed);
    if (error.empty()) *field = static_cast<float>(parsed);
    return error;
  };
  return add_entry(key, "number", unit, range_text(range), doc, effect, set, [field] {
    // The shortest text that yields this float; as a double it would have more digits.
    char buffer[32];
    return std::string(buffer, std::to_chars(buffer, buffer + sizeof buffer, *field).ptr);
  });
}

Parameters::Added Parameters::add_integer(const std::string& key, Range range, double lowest,
                                          double highest, const std::string& unit,
                                          const std::string& doc, Effect effect,
                                          const std::function<void(std::int64_t)>& assign,
                                          const std::function<std::int64_t()>& get) {
  const Range whole{std::max(range.min, lowest), std::min(range.max, highest)};
  const auto set = [whole, assign](const RawValue& value) -> std::string {
    if (value.shape != RawValue::Shape::kScalar) return kScalarWanted;
    std::int64_t parsed = 0;
    std::string error = set_integer(value.items[0], whole, &parsed);
    if (error.empty()) assign(parsed);
    return error;
  };
  return add_entry(key, "integer", unit, range_text(whole), doc, effect, set,
                   [get] { return std::to_string(get()); });
}

Parameters::Added Parameters::add(const std::string& key, std::string* field,
                                  const std::string& doc, Effect effect) {
  const auto set = [field](const RawValue& value) -> std::string {
    // An empty value in YAML is the empty text.
    if (value.shape == RawValue::Shape::kNull) {
      field->clear();
      return {};
    }
    if (value.shape != RawValue::Shape::kScalar) return kScalarWanted;
    // Only a shell expands it: a folder of the name "~" or "~user" would be made.
    const std::string& text = value.items[0];
    if (text.starts_with('~') && text.find('/') != std::string::npos) {
      return "'~' is not expanded: write the whole path";
    }
    *field = text;
    return {};
  };
  return add_entry(key, kTextType, "", "any text", doc, effect, set,
                   [field] { return Json(*field).dump(); });
}

Parameters::Added Parameters::add_choice(const std::string& key,
                                         const std::vector<std::string>& allowed,
                                         const std::string& doc, Effect effect,
                                         const std::function<void(std::size_t)>& assign,
                                         const std::function<std::size_t()>& get) {
  const std::string text = "one of " + join(allowed);
  const auto set = [allowed, assign](const RawValue& value) -> std::string {
    if (value.shape != RawValue::Shape::kScalar) return kScalarWanted;
    const auto it = std::find(allowed.begin(), allowed.end(), value.items[0]);
    if (it == allowed.end()) return "not a known choice";
    assign(static_cast<std::size_t>(it - allowed.begin()));
    return {};
  };
  return add_entry(key, "choice", "", text, doc, effect, set,
                   [allowed, get] { return Json(allowed.at(get())).dump(); });
}

Parameters::Added Parameters::add(const std::string& key, std::string* field,
                                  std::vector<std::string> allowed, const std::string& doc,
                                  Effect effect) {
  if (std::find(allowed.begin(), allowed.end(), *field) == allowed.end()) {
    throw std::logic_error("the default of " + key + " is not among its choices");
  }
  return add_choice(
      key, allowed, doc, effect, [field, allowed](std::size_t i) { *field = allowed[i]; },
      [field, allowed] {
        return static_cast<std::size_t>(std::find(allowed.begin(), allowed.end(), *field) -
                                        allowed.begin());
      });
}

Parameters::Added Parameters::add(const std::string& key, Eigen::Vector3d* field, Range range,
                                  const std::string& unit, const std::string& doc, Effect effect) {
  const auto set = [field, range](const RawValue& value) -> std::string {
    std::array<double, 3> parsed{};
    std::string error = set_triple<double, 3>(
        value, &parsed,
        [range](const std::string& text, double* v) { return set_double(text, range, v); });
    if (error.empty()) *field = Eigen::Vector3d(parsed[0], parsed[1], parsed[2]);
    return error;
  };
  return add_entry(key, "[x, y, z]", unit, "3 numbers, each " + range_text(range), doc, effect, set,
                   [field] {
                     return Json{field->x(), field->y(), field->z()}.dump();
                   });
}

Parameters::Added Parameters::add(const std::string& key, std::array<int, 3>* field, Range range,
                                  const std::string& unit, const std::string& doc, Effect effect) {
  const Range whole{std::max(range.min, -2147483648.0), std::min(range.max, 2147483647.0)};
  const auto set = [field, whole](const RawValue& value) -> std::string {
    return set_triple<int, 3>(value, field, [whole](const std::string& text, int* v) {
      std::int64_t wide = 0;
      std::string error = set_integer(text, whole, &wide);
      if (error.empty()) *v = static_cast<int>(wide);
      return error;
    });
  };
  return add_entry(key, "[x, y, z]", unit, "3 whole numbers, each " + range_text(whole), doc,
                   effect, set, [field] { return Json(*field).dump(); });
}

Parameters::Added Parameters::add(const std::string& key, std::vector<std::string>* field,
                                  const std::string& doc, Effect effect) {
  const auto set = [field](const RawValue& value) -> std::string {
    if (value.shape == RawValue::Shape::kNull) {
      field->clear();
      return {};
    }
    if (value.shape != RawValue::Shape::kList) return "a list is expected";
    *field = value.items;
    return {};
  };
  return add_entry(key, "list", "", "a list of texts", doc, effect, set,
                   [field] { return Json(*field).dump(); });
}

}  // namespace zloam::runtime
