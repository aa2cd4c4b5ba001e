#pragma once
// Binds names of the configuration file to fields of config structs. The struct's member
// initialisers are the defaults; the file and --set override them; everything is checked before a
// stage starts.
//
//   void bind(Parameters& p, RegistrationConfig& c) {
//     p.add("registration.min_range_m", &c.min_range_m, {0.0, 100.0}, "m", "minimum range");
//     p.add("registration.returns", &c.returns, {{"strongest", Returns::kStrongest}, ...},
//           "returns used of a firing with two");
//   }
//
// Names are dotted paths into the YAML file: nested maps, all lower case.

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <initializer_list>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

namespace zloam::runtime {

/// The configuration is refused; what() names file and line (or --set), key, value and what is
/// allowed.
class ConfigError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A file can't be read or written, a port is taken.
class IoError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Both ends included.
struct Range {
  double min = -std::numeric_limits<double>::infinity();
  double max = std::numeric_limits<double>::infinity();
};

/// Whether a value can change a result, and so belongs to the identity of a replay
/// (docs/protocol.md, section 1). Names, paths, endpoints and log settings do not.
enum class Effect : std::uint8_t { kResult, kNone };

/// A value as it stands in the file or in --set, before its type is known.
struct RawValue {
  enum class Shape : std::uint8_t { kScalar, kList, kMap, kNull };
  Shape shape = Shape::kNull;
  /// one text for a scalar, one an item for a list
  std::vector<std::string> items;
};

class Parameters {
 public:
  /// A parameter just declared.
  class Added {
   public:
    explicit Added(Parameters& parameters) : parameters_(parameters) {}
    /// It may change while running, from one sweep to the next (docs/protocol.md, section 13):
    /// read it again for each sweep, and keep nothing that was computed from it.
    void live() { parameters_.entries_.back().live = true; }

   private:
    Parameters& parameters_;
  };

  Parameters() = default;
  ~Parameters() = default;
  Parameters(const Parameters&) = delete;
  Parameters& operator=(const Parameters&) = delete;

  Added add(const std::string& key, bool* field, const std::string& doc,
            Effect effect = Effect::kResult);
  Added add(const std::string& key, double* field, Range range, const std::string& unit,
            const std::string& doc, Effect effect = Effect::kResult);
  Added add(const std::string& key, float* field, Range range, const std::string& unit,
            const std::string& doc, Effect effect = Effect::kResult);
  template <class Int>
  requires(std::is_integral_v<Int> && !std::is_same_v<Int, bool>) Added
      add(const std::string& key, Int* field, Range range, const std::string& unit,
          const std::string& doc, Effect effect = Effect::kResult);
  Added add(const std::string& key, std::string* field, const std::string& doc,
            Effect effect = Effect::kResult);
  /// One of the named texts.
  Added add(const std::string& key, std::string* field, std::vector<std::string> allowed,
            const std::string& doc, Effect effect = Effect::kResult);
  /// One of the named values.
  template <class Enum>
  requires std::is_enum_v<Enum> Added
  add(const std::string& key, Enum* field,
      std::vector<std::pair<std::string, std::type_identity_t<Enum>>> allowed,
      const std::string& doc, Effect effect = Effect::kResult);
  /// [x, y, z], each within the range.
  Added add(const std::string& key, Eigen::Vector3d* field, Range range, const std::string& unit,
            const std::string& doc, Effect effect = Effect::kResult);
  Added add(const std::string& key, std::array<int, 3>* field, Range range, const std::string& unit,
            const std::string& doc, Effect effect = Effect::kResult);
  Added add(const std::string& key, std::vector<std::string>* field, const std::string& doc,
            Effect effect = Effect::kResult);
  /// A condition over several fields, checked after all values are set: returns the error, or an
  /// empty text. key names the field to report. The place is that of the first of key and others
  /// that is set, because key may have its default.
  void check(const std::string& key, std::function<std::string()> condition,
             std::vector<std::string> others = {});

  /// Reads the file, then the settings "key=value". Sections (first chunk of a key) named in
  /// foreign belong to other programs and are passed over. Throws ConfigError with all errors, one
  /// a line, or IoError when the file can't be read.
  void load(const std::optional<std::string>& path, const std::vector<std::string>& settings,
            const std::vector<std::string>& foreign = {});
  /// The same from text; name stands for the file in errors.
  void load_text(const std::string& text, const std::string& name,
                 const std::vector<std::string>& settings,
                 const std::vector<std::string>& foreign = {});

  /// Checks and sets one value; returns the error, or an empty text.
  std::string set(const std::string& key, const RawValue& value);

  /// Sets every live parameter in the JSON object, as changed while running; throws ConfigError for
  /// a value that load() would refuse.
  void set_live(const std::string& values_json);
  /// Checks the settings "key=value" as load() does, only live keys allowed; the fields keep their
  /// values. Returns a JSON object of these keys with the values as they would be in force, or
  /// throws ConfigError with all errors, one a line. place stands for the command in errors.
  std::string check_live(const std::vector<std::string>& settings, const std::string& place);
  /// A JSON object: the live parameters and their values in force.
  std::string live_values_json() const;

  /// A JSON array: key, type, unit, range or allowed values, default, doc, and whether it can
  /// change a result.
  std::string describe_json() const;
  /// A JSON object: full key -> value in force, keys ascending.
  std::string values_json() const;
  /// The same with only what can change a result.
  std::string result_values_json() const;
  std::vector<std::string> keys() const;

 private:
  struct Entry {
    std::string key;
    std::string type;
    std::string unit;
    /// range or allowed values in words
    std::string allowed;
    std::string doc;
    Effect effect;
    std::function<std::string(const RawValue&)> set;
    /// the value in force as JSON text
    std::function<std::string()> get_json;
    std::string default_json;
    bool live = false;
  };
  struct Check {
    std::string key;
    std::function<std::string()> condition;
    std::vector<std::string> others;
  };

  Added add_entry(const std::string& key, std::string type, std::string unit, std::string allowed,
                  std::string doc, Effect effect, std::function<std::string(const RawValue&)> set,
                  std::function<std::string()> get_json);
  Added add_integer(const std::string& key, Range range, double lowest, double highest,
                    const std::string& unit, const std::string& doc, Effect effect,
                    const std::function<void(std::int64_t)>& set,
                    const std::function<std::int64_t()>& get);
  Added add_choice(const std::string& key, const std::vector<std::string>& allowed,
                   const std::string& doc, Effect effect,
                   const std::function<void(std::size_t)>& set,
                   const std::function<std::size_t()>& get);
  const Entry* find(const std::string& key) const;
  std::string nearest(const std::string& key) const;
  std::string json_object(const std::function<bool(const Entry&)>& wanted) const;
  struct Loader;

  std::vector<Entry> entries_;
  std::vector<Check> checks_;
};

template <class Int>
requires(std::is_integral_v<Int> && !std::is_same_v<Int, bool>) Parameters::Added Parameters::add(
    const std::string& key, Int* field, Range range, const std::string& unit,
    const std::string& doc, Effect effect) {
  // 2^53: whole numbers that a double, and so JSON, holds exactly.
  constexpr double kExact = 9007199254740992.0;
  const double lowest = std::max(static_cast<double>(std::numeric_limits<Int>::min()), -kExact);
  const double highest = std::min(static_cast<double>(std::numeric_limits<Int>::max()), kExact);
  return add_integer(
      key, range, lowest, highest, unit, doc, effect,
      [field](std::int64_t v) { *field = static_cast<Int>(v); },
      [field] { return static_cast<std::int64_t>(*field); });
}

template <class Enum>
requires std::is_enum_v<Enum> Parameters::Added Parameters::add(
    const std::string& key, Enum* field,
    std::vector<std::pair<std::string, std::type_identity_t<Enum>>> allowed, const std::string& doc,
    Effect effect) {
  std::vector<std::string> names;
  std::vector<Enum> values;
  for (auto& [name, value] : allowed) {
    names.push_back(name);
    values.push_back(value);
  }
  return add_choice(
      key, names, doc, effect, [field, values](std::size_t i) { *field = values[i]; },
      [field, values] {
        std::size_t i = 0;
        while (i + 1 < values.size() && values[i] != *field) ++i;
        return i;
      });
}

}  // namespace zloam::runtime
