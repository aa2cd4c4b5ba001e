// Reads a robot's YAML file and --set into parameters.

#include <yaml-cpp/eventhandler.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "common/runtime/json_guard.hpp"
#include "common/runtime/parameter_text.hpp"
#include "common/runtime/parameters.hpp"

namespace zloam::runtime {
namespace {

/// Notes the line, from 1, at which the first node of a document begins.
class FirstLine : public YAML::EventHandler {
 public:
  void OnDocumentStart(const YAML::Mark&) override { line.reset(); }
  void OnDocumentEnd() override {}
  void OnNull(const YAML::Mark& mark, YAML::anchor_t) override { note(mark); }
  void OnAlias(const YAML::Mark& mark, YAML::anchor_t) override { note(mark); }
  void OnScalar(const YAML::Mark& mark, const std::string&, YAML::anchor_t,
                const std::string&) override {
    note(mark);
  }
  void OnSequenceStart(const YAML::Mark& mark, const std::string&, YAML::anchor_t,
                       YAML::EmitterStyle::value) override {
    note(mark);
  }
  void OnSequenceEnd() override {}
  void OnMapStart(const YAML::Mark& mark, const std::string&, YAML::anchor_t,
                  YAML::EmitterStyle::value) override {
    note(mark);
  }
  void OnMapEnd() override {}

  std::optional<int> line;

 private:
  void note(const YAML::Mark& mark) { line = line.value_or(mark.line + 1); }
};

/// The line at which something follows the first document of the text. YAML::LoadAll() can't tell:
/// it takes a comma behind a '}' for a document, again and again without end.
std::optional<int> line_after_document(const std::string& text) {
  std::istringstream stream(text);
  YAML::Parser parser(stream);
  FirstLine first_line;
  parser.HandleNextDocument(first_line);
  const bool more = parser.HandleNextDocument(first_line);
  return more ? first_line.line : std::nullopt;
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

RawValue raw_value(const nlohmann::json& json) {
  const auto text = [](const nlohmann::json& item) {
    return item.is_string() ? item.get<std::string>() : item.dump();
  };
  RawValue value;
  value.shape = json.is_array() ? RawValue::Shape::kList : RawValue::Shape::kScalar;
  if (json.is_array()) {
    for (const auto& item : json) value.items.push_back(text(item));
  } else {
    value.items = {text(json)};
  }
  return value;
}

}  // namespace

/// Reads the file and the settings; collects all errors before it throws.
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

  static std::string within(const std::string& section, const std::string& leaf) {
    return section.empty() ? leaf : section + "." + leaf;
  }

  void complain(const std::string& place, const std::string& key, const std::string& what) {
    errors.push_back(place + ": " + key + ": " + what);
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
      complain(place, key, error);
    }
  }

  void walk(const YAML::Node& map, const std::string& prefix) {
    std::set<std::string> seen;
    for (const auto& item : map) {
      const bool is_name = item.first.IsScalar();
      const std::string leaf = is_name ? item.first.Scalar() : shown(raw_value(item.first));
      const std::string place = name + ":" + line_of(item.first);
      const std::string key = within(prefix, leaf);
      if (!is_name) {
        complain(place, key, "a name is expected as key");
      } else if (!seen.insert(leaf).second) {
        complain(place, key, "stands here a second time");
      } else if (const auto dot = leaf.find('.'); dot != std::string::npos) {
        // Whoever reads only sections would miss it, and it could contradict the section.
        complain(place, key,
                 "a file has sections, not keys with dots: write " + leaf.substr(0, dot) + ": {" +
                     leaf.substr(dot + 1) + ": ...}");
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
      complain(place, key,
               "a section with keys of its own is expected, not " + shown(raw_value(node)));
    }
  }

  /// Whether the key is in another program's section and not among the few keys there that this
  /// program reads as well.
  bool is_foreign(const std::string& key) const {
    const std::string section_name = key.substr(0, key.find('.'));
    return std::find(foreign.begin(), foreign.end(), section_name) != foreign.end() &&
           parameters.find(key) == nullptr && !is_prefix(key);
  }

  /// The only document of the text. YAML::Load() takes the first one and skips the others.
  YAML::Node document(const std::string& text) {
    try {
      YAML::Node found = YAML::Load(text);
      if (const std::optional<int> line = line_after_document(text)) {
        errors.push_back(name + ":" + std::to_string(*line) +
                         ": a second document (after '---', '...' or a comma too many) is not "
                         "read: a file has one");
      }
      return found;
    } catch (const YAML::Exception& e) {
      throw ConfigError(name + ":" + std::to_string(e.mark.line + 1) + ": not YAML: " + e.msg);
    }
  }

  void file(const std::string& text) {
    const YAML::Node root = document(text);
    if (root.IsMap()) {
      walk(root, "");
    } else if (!root.IsNull()) {
      errors.push_back(name + ":1: a map of sections is expected");
    }
  }

  struct Setting {
    std::string key;
    RawValue value;
  };

  /// Nothing if the setting is invalid (the error is recorded) or not for this program.
  std::optional<Setting> read(const std::string& text, const std::string& place) {
    const auto equals = text.find('=');
    const std::string key = text.substr(0, equals);
    if (equals == std::string::npos || key.empty()) {
      errors.push_back(place + ": '" + text + "': key=value is expected");
      return std::nullopt;
    }
    if (is_foreign(key)) return std::nullopt;
    std::string value = text.substr(equals + 1);
    // Texts are not parsed as YAML: a path may contain " #" or ": ", which have a meaning there.
    const Entry* entry = parameters.find(key);
    if (entry != nullptr && entry->type == kTextType) {
      return Setting{key, {RawValue::Shape::kScalar, {std::move(value)}}};
    }
    try {
      return Setting{key, raw_value(YAML::Load(value))};
    } catch (const YAML::Exception& e) {
      complain(place, key, "not a YAML value: " + e.msg);
      return std::nullopt;
    }
  }

  void setting(const std::string& text) {
    if (const auto s = read(text, "--set")) set_at("--set " + s->key, s->key, s->value);
  }

  void live_setting(const std::string& text, const std::string& place) {
    const auto s = read(text, place);
    if (!s) return;
    const Entry* entry = parameters.find(s->key);
    if (entry != nullptr && entry->live) {
      set_at(place, s->key, s->value);
      return;
    }
    const std::string why = entry == nullptr
                                ? parameters.set(s->key, s->value)
                                : "it can't change while running, start the stage again with it";
    complain(place, s->key,
             "value " + shown(s->value) + " is refused: " + why + "; allowed: " + live_keys());
  }

  std::string live_keys() const {
    std::vector<std::string> live;
    for (const Entry& e : parameters.entries_) {
      if (e.live) live.push_back(e.key);
    }
    return live.empty() ? "nothing" : join(live);
  }

  void conditions() {
    for (const Check& check : parameters.checks_) {
      const std::string error = check.condition();
      if (!error.empty()) complain(place_of(check), check.key, error);
    }
  }

  std::string place_of(const Check& check) const {
    if (const auto place = places.find(check.key); place != places.end()) return place->second;
    for (const std::string& other : check.others) {
      if (const auto place = places.find(other); place != places.end()) return place->second;
    }
    return name;
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

void Parameters::set_live(const std::string& values_json) {
  if (const std::string error = json_error(values_json); !error.empty()) throw ConfigError(error);
  const nlohmann::json values = nlohmann::json::parse(values_json, nullptr, false);
  if (!values.is_object()) throw ConfigError("a JSON object is expected, not " + values_json);
  for (const auto& [key, value] : values.items()) {
    const Entry* entry = find(key);
    std::string error = "can't change while running";
    if (entry != nullptr && entry->live) error = set(key, raw_value(value));
    if (!error.empty()) throw ConfigError(error.insert(0, key + ": "));
  }
}

std::string Parameters::check_live(const std::vector<std::string>& settings,
                                   const std::string& place) {
  const std::string before = live_values_json();
  const std::vector<std::string> foreign;
  Loader loader{*this, place, foreign};
  for (const std::string& setting : settings) loader.live_setting(setting, place);
  if (settings.empty()) loader.errors.push_back(place + ": key=value is expected");
  if (loader.errors.empty()) loader.conditions();
  std::string values = json_object([&](const Entry& e) { return loader.places.contains(e.key); });
  set_live(before);
  loader.finish();
  return values;
}

}  // namespace zloam::runtime
