#include "common/runtime/parameters.hpp"

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <numeric>

#include "common/runtime/parameter_text.hpp"

namespace zloam::runtime {
namespace {

using Json = nlohmann::ordered_json;

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

}  // namespace

Parameters::Added Parameters::add_entry(const std::string& key, std::string type, std::string unit,
                                        std::string allowed, std::string doc, Effect effect,
                                        std::function<std::string(const RawValue&)> set,
                                        std::function<std::string()> get_json) {
  if (find(key) != nullptr) throw std::logic_error("parameter " + key + " is bound twice");
  std::string default_json = get_json();
  entries_.push_back({key, std::move(type), std::move(unit), std::move(allowed), std::move(doc),
                      effect, std::move(set), std::move(get_json), std::move(default_json)});
  return Added(*this);
}

void Parameters::check(const std::string& key, std::function<std::string()> condition,
                       std::vector<std::string> others) {
  checks_.push_back({key, std::move(condition), std::move(others)});
}

const Parameters::Entry* Parameters::find(const std::string& key) const {
  for (const Entry& entry : entries_) {
    if (entry.key == key) return &entry;
  }
  return nullptr;
}

std::string Parameters::nearest(const std::string& key) const {
  std::string best;
  // A suggestion that differs in more than about a third of the name would mislead.
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

std::string Parameters::describe_json() const {
  Json list = Json::array();
  for (const Entry& e : entries_) {
    list.push_back({{"key", e.key},
                    {"type", e.type},
                    {"unit", e.unit},
                    {"allowed", e.allowed},
                    {"default", Json::parse(e.default_json)},
                    {"changes_result", e.effect == Effect::kResult},
                    {"live", e.live},
                    {"doc", e.doc}});
  }
  return list.dump(2);
}

std::string Parameters::json_object(const std::function<bool(const Entry&)>& wanted) const {
  std::map<std::string, std::string> sorted;
  for (const Entry& e : entries_) {
    if (wanted(e)) sorted[e.key] = e.get_json();
  }
  std::string text = "{";
  for (const auto& [key, json] : sorted) {
    text += (text.size() == 1 ? "" : ",") + Json(key).dump() + ":" + json;
  }
  return text + "}";
}

std::string Parameters::values_json() const {
  return json_object([](const Entry&) { return true; });
}

std::string Parameters::result_values_json() const {
  return json_object([](const Entry& e) { return e.effect == Effect::kResult; });
}

std::string Parameters::live_values_json() const {
  return json_object([](const Entry& e) { return e.live; });
}

std::vector<std::string> Parameters::keys() const {
  std::vector<std::string> keys;
  for (const Entry& e : entries_) keys.push_back(e.key);
  return keys;
}

}  // namespace zloam::runtime
