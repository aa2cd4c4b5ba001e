#include "common/runtime/parameters.hpp"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <numeric>
#include <set>
#include <sstream>

namespace zloam::runtime {
namespace {

using Json = nlohmann::ordered_json;
using Setter = std::function<std::string(const RawValue&)>;

constexpr const char* kScalarWanted = "a single value is expected";

std::string number_text(double value) {
  char buffer[32];
  const auto end = std::to_chars(buffer, buffer + sizeof buffer, value);
  return {buffer, end.ptr};
}

std::string range_text(Range range) {
  const bool low = std::isfinite(range.min);
  const bool high = std::isfinite(range.max);
  if (low && high) return number_text(range.min) + " to " + number_text(range.max);
  if (low) return number_text(range.min) + " or more";
  if (high) return number_text(range.max) + " or less";
  return "any finite number";
}

/// The whole text as a number; YAML's 1_000 and hexadecimal are not.
template <class Number>
bool parse_number(const std::string& text, Number* value) {
  const char* begin = text.data() + (text.starts_with('+') ? 1 : 0);
  const char* end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(begin, end, *value);
  return error == std::errc{} && stop == end && begin != end;
}

std::string set_double(const std::string& text, Range range, double* value) {
  double parsed = 0.0;
  if (!parse_number(text, &parsed) || !std::isfinite(parsed)) return "a number is expected";
  if (parsed < range.min || parsed > range.max) return "out of range";
  *value = parsed;
  return {};
}

std::string set_integer(const std::string& text, Range range, std::int64_t* value) {
  std::int64_t parsed = 0;
  if (!parse_number(text, &parsed)) return "a whole number is expected";
  const auto wide = static_cast<double>(parsed);
  if (wide < range.min || wide > range.max) return "out of range";
  *value = parsed;
  return {};
}

std::string join(const std::vector<std::string>& items) {
  std::string text;
  for (const std::string& item : items) text += (text.empty() ? "" : ", ") + item;
  return text;
}

std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t change = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, change});
    }
  }
  return row.back();
}

std::string shown(const RawValue& value) {
  switch (value.shape) {
    case RawValue::Shape::kScalar:
      return "'" + value.items.front() + "'";
    case RawValue::Shape::kList:
      return "[" + join(value.items) + "]";
    case RawValue::Shape::kMap:
      return "a section";
    case RawValue::Shape::kNull:
      return "nothing";
  }
  return "?";
}

RawValue raw_value(const YAML::Node& node) {
  RawValue value;
  if (node.IsScalar()) {
    value.shape = RawValue::Shape::kScalar;
    value.items = {node.Scalar()};
  } else if (node.IsSequence()) {
    value.shape = RawValue::Shape::kList;
    for (const auto& item : node) {
      value.items.push_back(item.IsScalar() ? item.Scalar() : std::string("(not a single value)"));
    }
  } else if (node.IsMap()) {
    value.shape = RawValue::Shape::kMap;
  }
  return value;
}

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

struct Parameters::Entry {
  std::string key;
  std::string type;
  std::string unit;
  /// range or allowed values in words
  std::string allowed;
  std::string doc;
  Effect effect;
  Setter set;
  /// the value in force as JSON text
  std::function<std::string()> get_json;
  std::string default_json;
};

struct Parameters::Check {
  std::string key;
  std::function<std::string()> condition;
};

Parameters::Parameters() = default;
Parameters::~Parameters() = default;

void Parameters::add_entry(const std::string& key, std::string type, std::string unit,
                           std::string allowed, std::string doc, Effect effect, Setter set,
                           std::function<std::string()> get_json) {
  if (find(key) != nullptr) throw std::logic_error("parameter " + key + " is bound twice");
  std::string default_json = get_json();
  entries_.push_back({key, std::move(type), std::move(unit), std::move(allowed), std::move(doc),
                      effect, std::move(set), std::move(get_json), std::move(default_json)});
}

void Parameters::add(const std::string& key, bool* field, const std::string& doc, Effect effect) {
  const auto set = [field](const RawValue& value) -> std::string {
    if (value.shape != RawValue::Shape::kScalar) return kScalarWanted;
    if (value.items[0] != "true" && value.items[0] != "false") return "true or false is expected";
    *field = value.items[0] == "true";
    return {};
  };
  add_entry(key, "bool", "", "true or false", doc, effect, set,
            [field] { return std::string(*field ? "true" : "false"); });
}

void Parameters::add(const std::string& key, double* field, Range range, const std::string& unit,
                     const std::string& doc, Effect effect) {
  const auto set = [field, range](const RawValue& value) -> std::string {
    if (value.shape != RawValue::Shape::kScalar) return kScalarWanted;
    return set_double(value.items[0], range, field);
  };
  add_entry(key, "number", unit, range_text(range), doc, effect, set,
            [field] { return Json(*field).dump(); });
}

void Parameters::add(const std::string& key, float* field, Range range, const std::string& unit,
                     const std::string& doc, Effect effect) {
  const auto set = [field, range](const RawValue& value) -> std::string {
    if (value.shape != RawValue::Shape::kScalar) return kScalarWanted;
    double parsed = 0.0;
    std::string error = set_double(value.items[0], range, &parsed);
    if (error.empty()) *field = static_cast<float>(parsed);
    return error;
  };
  add_entry(key, "number", unit, range_text(range), doc, effect, set, [field] {
    // The shortest text of the float, not the double's long tail.
    char buffer[32];
    return std::string(buffer, std::to_chars(buffer, buffer + sizeof buffer, *field).ptr);
  });
}

void Parameters::add_integer(const std::string& key, Range range, double lowest, double highest,
                             const std::string& unit, const std::string& doc, Effect effect,
                             std::function<void(std::int64_t)> assign,
                             std::function<std::int64_t()> get) {
  const Range whole{std::max(range.min, lowest), std::min(range.max, highest)};
  const auto set = [whole, assign](const RawValue& value) -> std::string {
    if (value.shape != RawValue::Shape::kScalar) return kScalarWanted;
    std::int64_t parsed = 0;
    std::string error = set_integer(value.items[0], whole, &parsed);
    if (error.empty()) assign(parsed);
    return error;
  };
  add_entry(key, "integer", unit, range_text(whole), doc, effect, set,
            [get] { return std::to_string(get()); });
}

void Parameters::add(const std::string& key, std::string* field, const std::string& doc,
                     Effect effect) {
  const auto set = [field](const RawValue& value) -> std::string {
    // An empty value in YAML is the empty text.
    if (value.shape == RawValue::Shape::kNull) {
      field->clear();
      return {};
    }
    if (value.shape != RawValue::Shape::kScalar) return kScalarWanted;
    *field = value.items[0];
    return {};
  };
  add_entry(key, "text", "", "any text", doc, effect, set, [field] { return Json(*field).dump(); });
}

void Parameters::add_choice(const std::string& key, std::vector<std::string> allowed,
                            const std::string& doc, Effect effect,
                            std::function<void(std::size_t)> assign,
                            std::function<std::size_t()> get) {
  const std::string text = "one of " + join(allowed);
  const auto set = [allowed, assign](const RawValue& value) -> std::string {
    if (value.shape != RawValue::Shape::kScalar) return kScalarWanted;
    const auto it = std::find(allowed.begin(), allowed.end(), value.items[0]);
    if (it == allowed.end()) return "not a known choice";
    assign(static_cast<std::size_t>(it - allowed.begin()));
    return {};
  };
  add_entry(key, "choice", "", text, doc, effect, set,
            [allowed, get] { return Json(allowed.at(get())).dump(); });
}

void Parameters::add(const std::string& key, std::string* field, std::vector<std::string> allowed,
                     const std::string& doc, Effect effect) {
  if (std::find(allowed.begin(), allowed.end(), *field) == allowed.end()) {
    throw std::logic_error("the default of " + key + " is not among its choices");
  }
  add_choice(
      key, allowed, doc, effect, [field, allowed](std::size_t i) { *field = allowed[i]; },
      [field, allowed] {
        return static_cast<std::size_t>(std::find(allowed.begin(), allowed.end(), *field) -
                                        allowed.begin());
      });
}

void Parameters::add(const std::string& key, Eigen::Vector3d* field, Range range,
                     const std::string& unit, const std::string& doc, Effect effect) {
  const auto set = [field, range](const RawValue& value) -> std::string {
    std::array<double, 3> parsed{};
    std::string error = set_triple<double, 3>(
        value, &parsed,
        [range](const std::string& text, double* v) { return set_double(text, range, v); });
    if (error.empty()) *field = Eigen::Vector3d(parsed[0], parsed[1], parsed[2]);
    return error;
  };
  add_entry(key, "[x, y, z]", unit, "3 numbers, each " + range_text(range), doc, effect, set,
            [field] {
              return Json{field->x(), field->y(), field->z()}.dump();
            });
}

void Parameters::add(const std::string& key, std::array<int, 3>* field, Range range,
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
  add_entry(key, "[x, y, z]", unit, "3 whole numbers, each " + range_text(whole), doc, effect, set,
            [field] { return Json(*field).dump(); });
}

void Parameters::add(const std::string& key, std::vector<std::string>* field,
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
  add_entry(key, "list", "", "a list of texts", doc, effect, set,
            [field] { return Json(*field).dump(); });
}

void Parameters::check(const std::string& key, std::function<std::string()> condition) {
  checks_.push_back({key, std::move(condition)});
}

const Parameters::Entry* Parameters::find(const std::string& key) const {
  for (const Entry& entry : entries_) {
    if (entry.key == key) return &entry;
  }
  return nullptr;
}

std::string Parameters::nearest(const std::string& key) const {
  std::string best;
  // Beyond a third of the name a suggestion misleads.
  std::size_t best_distance = key.size() / 3 + 2;
  for (const Entry& entry : entries_) {
    const std::size_t distance = edit_distance(key, entry.key);
    if (distance < best_distance) {
      best = entry.key;
      best_distance = distance;
    }
  }
  return best;
}

std::string Parameters::set(const std::string& key, const RawValue& value) {
  const Entry* entry = find(key);
  if (entry == nullptr) {
    const std::string near = nearest(key);
    return "unknown key" + (near.empty() ? "" : " (did you mean '" + near + "'?)");
  }
  std::string error = entry->set(value);
  if (error.empty()) return {};
  const std::string unit = entry->unit.empty() ? "" : " " + entry->unit;
  return "value " + shown(value) + " is refused: " + error + "; allowed: " + entry->allowed + unit;
}

/// One reading of file and settings; collects all errors before it throws.
struct Parameters::Loader {
  Parameters& parameters;
  const std::string& name;
  const std::vector<std::string>& foreign;
  std::vector<std::string> errors{};
  /// where each key was last set
  std::map<std::string, std::string> places{};

  static std::string line_of(const YAML::Node& node) {
    return std::to_string(node.Mark().line + 1);
  }

  bool is_prefix(const std::string& key) const {
    return std::any_of(parameters.entries_.begin(), parameters.entries_.end(),
                       [&](const Entry& e) { return e.key.starts_with(key + "."); });
  }

  void set_at(const std::string& place, const std::string& key, const RawValue& value) {
    const std::string error = parameters.set(key, value);
    if (error.empty()) {
      places[key] = place;
    } else {
      errors.push_back(place + ": " + key + ": " + error);
    }
  }

  void walk(const YAML::Node& map, const std::string& prefix) {
    std::set<std::string> seen;
    for (const auto& item : map) {
      const std::string leaf = item.first.IsScalar() ? item.first.Scalar() : "?";
      const std::string place = name + ":" + line_of(item.first);
      const std::string key = prefix.empty() ? leaf : prefix + "." + leaf;
      if (!seen.insert(leaf).second) {
        errors.push_back(place + ": " + key + ": stands here a second time");
      } else if (is_foreign(key)) {
        continue;
      } else if (is_prefix(key)) {
        section(item.second, key, place);
      } else {
        set_at(place, key, raw_value(item.second));
      }
    }
  }

  void section(const YAML::Node& node, const std::string& key, const std::string& place) {
    if (node.IsMap()) {
      walk(node, key);
    } else if (!node.IsNull()) {
      errors.push_back(place + ": " + key + ": a section with keys of its own is expected, not " +
                       shown(raw_value(node)));
    }
  }

  /// Of another program's section, and not one of the few keys of it that this one reads as well.
  bool is_foreign(const std::string& key) const {
    const std::string section_name = key.substr(0, key.find('.'));
    return std::find(foreign.begin(), foreign.end(), section_name) != foreign.end() &&
           parameters.find(key) == nullptr && !is_prefix(key);
  }

  void file(const std::string& text) {
    YAML::Node root;
    try {
      root = YAML::Load(text);
    } catch (const YAML::Exception& e) {
      throw ConfigError(name + ":" + std::to_string(e.mark.line + 1) + ": not YAML: " + e.msg);
    }
    if (root.IsMap()) {
      walk(root, "");
    } else if (!root.IsNull()) {
      errors.push_back(name + ":1: a map of sections is expected");
    }
  }

  void setting(const std::string& text) {
    const auto equals = text.find('=');
    const std::string key = text.substr(0, equals);
    const std::string place = "--set " + key;
    if (equals == std::string::npos || key.empty()) {
      errors.push_back("--set " + text + ": key=value is expected");
      return;
    }
    if (is_foreign(key)) return;
    RawValue value;
    try {
      value = raw_value(YAML::Load(text.substr(equals + 1)));
    } catch (const YAML::Exception& e) {
      errors.push_back(place + ": " + key + ": not a YAML value: " + e.msg);
      return;
    }
    set_at(place, key, value);
  }

  void conditions() {
    for (const Check& check : parameters.checks_) {
      const std::string error = check.condition();
      if (error.empty()) continue;
      const auto place = places.find(check.key);
      errors.push_back((place == places.end() ? name : place->second) + ": " + check.key + ": " +
                       error);
    }
  }

  void finish() const {
    if (errors.empty()) return;
    std::string all;
    for (const std::string& error : errors) all += (all.empty() ? "" : "\n") + error;
    throw ConfigError(all);
  }
};

void Parameters::load(const std::optional<std::string>& path,
                      const std::vector<std::string>& settings,
                      const std::vector<std::string>& foreign) {
  if (!path) {
    load_text("", "(no file)", settings, foreign);
    return;
  }
  std::ifstream file(*path);
  std::ostringstream text;
  if (!file) throw IoError(*path + ": can't be read: " + std::strerror(errno));
  if (std::filesystem::is_directory(*path)) throw IoError(*path + ": is a directory");
  text << file.rdbuf();
  if (file.bad()) throw IoError(*path + ": can't be read to its end");
  load_text(text.str(), *path, settings, foreign);
}

void Parameters::load_text(const std::string& text, const std::string& name,
                           const std::vector<std::string>& settings,
                           const std::vector<std::string>& foreign) {
  Loader loader{*this, name, foreign};
  loader.file(text);
  for (const std::string& setting : settings) loader.setting(setting);
  // Conditions over several fields only make sense when each field is right.
  if (loader.errors.empty()) loader.conditions();
  loader.finish();
}

std::string Parameters::describe_json() const {
  Json list = Json::array();
  for (const Entry& e : entries_) {
    list.push_back({{"key", e.key},
                    {"type", e.type},
                    {"unit", e.unit},
                    {"allowed", e.allowed},
                    {"default", Json::parse(e.default_json)},
                    {"changes_result", e.effect == Effect::kResult},
                    {"doc", e.doc}});
  }
  return list.dump(2);
}

std::string Parameters::json_object(bool only_result) const {
  std::map<std::string, std::string> sorted;
  for (const Entry& e : entries_) {
    if (!only_result || e.effect == Effect::kResult) sorted[e.key] = e.get_json();
  }
  std::string text = "{";
  for (const auto& [key, json] : sorted) {
    text += (text.size() == 1 ? "" : ",") + Json(key).dump() + ":" + json;
  }
  return text + "}";
}

std::string Parameters::values_json() const { return json_object(false); }
std::string Parameters::result_values_json() const { return json_object(true); }

std::vector<std::string> Parameters::keys() const {
  std::vector<std::string> keys;
  for (const Entry& e : entries_) keys.push_back(e.key);
  return keys;
}

}  // namespace zloam::runtime
