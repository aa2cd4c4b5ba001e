#include "messages.hpp"

#include <flatbuffers/flatbuffers.h>
#include <flatbuffers/reflection_generated.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <string_view>

#include "common/geometry/point.hpp"

namespace zloam::fuzz {
namespace {

using reflection::BaseType;
using Bytes = std::vector<std::uint8_t>;

constexpr int kRings = 16;
constexpr std::size_t kPackets = 20, kPacket_bytes = 1206;
constexpr std::int64_t kPeriod_ns = 100'000'000;
// Meaning of a choice byte: below kUsual the usual value, below kNear one near it, else any value.
constexpr std::uint8_t kUsual = 216, kNear = 240;

/// The usual value of a field in sweep n of run 7.
double usual(std::string_view name, std::uint64_t n) {
  static const std::map<std::string_view, double> kConstants = {{"run", 7},
                                                                {"rings", kRings},
                                                                {"period_ns", kPeriod_ns},
                                                                {"edge_m", 20},
                                                                {"levels", 3},
                                                                {"root_voxel_m", 1},
                                                                {"map_id", 7},
                                                                {"rev", 1},
                                                                {"range_noise_m", 0.02},
                                                                {"residual_m", .02},
                                                                {"from_sweep", 2},
                                                                {"packets", 76},
                                                                {"points_in", 500},
                                                                {"iterations", 3},
                                                                {"correspondences", 200},
                                                                {"latitude_deg", 8},
                                                                {"length", 1206},
                                                                {"packet_period_ns", 1'327'104},
                                                                {"complete", 1},
                                                                {"count", 9},
                                                                {"weak_sigma_measured", .1},
                                                                {"port", 2368},
                                                                {"has_correction", 1},
                                                                {"fit", 1}};
  const auto ns = static_cast<double>(n * kPeriod_ns);
  if (name == "sweep" || name == "seq" || name == "version" || name == "next_sweep" ||
      name == "done_below" || name == "received_below" || name == "correction_sweep") {
    return static_cast<double>(n);
  }
  if (name == "prev_sweep") return n > 0 ? static_cast<double>(n - 1) : 0.0;
  if (name == "instant_ns") return ns + kPeriod_ns;
  if (name.ends_with("_ns") && !kConstants.contains(name)) return ns;
  const auto found = kConstants.find(name);
  return found == kConstants.end() ? 0.0 : found->second;
}

std::size_t count_of(std::string_view name, std::size_t points) {
  if (name == "covariance" || name == "inertial_covariance") return 36;
  if (name == "state_covariance") return 144;
  if (name == "entries") return std::min(points, kPackets);
  if (name == "data") return std::min(points, kPackets) * kPacket_bytes;
  if (name == "missing") return std::min<std::size_t>(points, 3);
  return points;
}

double wild(Input& in) {
  static constexpr double kWild[] = {NAN,  INFINITY, -INFINITY, 1e300, -1e300, 1e15, -1e15, 1e7,
                                     -1e7, 1e6,      1e-300,    -0.0,  0.5,    -1.0, 4e9,   1e19};
  return kWild[in.byte() % std::size(kWild)];
}

double number(std::string_view name, std::uint64_t n, Input& in) {
  const std::uint8_t choice = in.byte();
  const double value = usual(name, n);
  if (choice < kUsual) return value;
  const auto near = static_cast<double>(static_cast<std::int8_t>(in.byte()));
  if (choice < kNear) return name.ends_with("_ns") ? value + near * 1e7 : value + near;
  return wild(in);
}

std::size_t size_of(BaseType type) {
  switch (type) {
    case BaseType::Short:
    case BaseType::UShort:
      return 2;
    case BaseType::Int:
    case BaseType::UInt:
    case BaseType::Float:
      return 4;
    case BaseType::Long:
    case BaseType::ULong:
    case BaseType::Double:
      return 8;
    default:
      return 1;
  }
}

/// Writes the value as an integer of `size` bytes, wrapped as the hardware would.
void put_integer(std::uint8_t* at, std::size_t size, double value) {
  const bool fits = value >= -9.2e18 && value <= 9.2e18;
  const std::int64_t whole = fits ? static_cast<std::int64_t>(value)
                                  : (value > 0 ? std::numeric_limits<std::int64_t>::max()
                                               : std::numeric_limits<std::int64_t>::min());
  std::memcpy(at, &whole, size);
}

void put(std::uint8_t* at, BaseType type, double value) {
  if (type == BaseType::Double) {
    std::memcpy(at, &value, sizeof value);
  } else if (type == BaseType::Float) {
    const bool fits = std::isnan(value) || std::isinf(value) || std::abs(value) < 3e38;
    const float narrow = fits ? static_cast<float>(value) : std::copysign(3e38F, value);
    std::memcpy(at, &narrow, sizeof narrow);
  } else if (type == BaseType::Bool) {
    *at = value > 0.5 ? 1 : 0;
  } else {
    put_integer(at, size_of(type), value);
  }
}

/// Byte i of the packets of a VLP-16 that rotates by 0.4 degrees per block and measures 10 m
/// everywhere.
std::uint8_t packet_byte(std::size_t i, std::uint64_t n) {
  static constexpr std::uint8_t kTail[] = {0, 0, 0, 0, 0x37, 0x22};
  const std::size_t packet = i / kPacket_bytes, at = i % kPacket_bytes;
  if (at >= 1200) return kTail[at - 1200];
  const std::size_t turn = (n * kPackets + packet) * 12 + at / 100;
  const std::size_t azimuth_cdeg = 40 * turn % 36000;
  const std::uint8_t head[] = {0xFF, 0xEE, static_cast<std::uint8_t>(azimuth_cdeg),
                               static_cast<std::uint8_t>(azimuth_cdeg >> 8)};
  if (at % 100 < 4) return head[at % 100];
  static constexpr std::uint8_t kReturn[] = {0x88, 0x13, 50};
  return kReturn[(at % 100 - 4) % 3];
}

/// A return from a room of 12 x 8 x 3 m, at the sensor's position in sweep n.
void room_point(float* xyz, std::size_t i, std::uint64_t n) {
  const double azimuth = 2.399963 * static_cast<double>(i / kRings);
  const double elevation = (static_cast<double>(i % kRings) * 2.0 - 15.0) * M_PI / 180.0;
  const double x0 = 0.05 * static_cast<double>(n % 40);
  const double d[3] = {std::cos(elevation) * std::cos(azimuth),
                       std::cos(elevation) * std::sin(azimuth), std::sin(elevation)};
  const double most[3] = {6.0 - x0, 4.0, 2.0}, least[3] = {-6.0 - x0, -4.0, -1.0};
  double range = 100.0;
  for (int k = 0; k < 3; ++k) {
    if (std::abs(d[k]) > 1e-6) range = std::min(range, (d[k] > 0 ? most[k] : least[k]) / d[k]);
  }
  for (int k = 0; k < 3; ++k) xyz[k] = static_cast<float>(range * d[k]);
}

}  // namespace

std::uint64_t Input::word() {
  std::uint64_t value = 0;
  for (int i = 0; i < 8; ++i) value = value << 8 | byte();
  return value;
}

std::string Input::text(std::size_t at_most) {
  std::string text(byte() % (at_most + 1), '\0');
  for (char& c : text) c = static_cast<char>(byte());
  return text;
}

struct MessageMaker::Impl {
  std::string folder;
  std::map<std::string, Bytes> files;
  std::uint64_t sweep = 0;
  std::uint8_t replay = 0;
  // State of the message that is being made.
  const reflection::Schema* schema = nullptr;
  Input* in = nullptr;
  std::size_t points = 0;

  const reflection::Schema& load(const std::string& name) {
    Bytes& bytes = files[name];
    if (bytes.empty()) {
      std::ifstream file(folder + "/" + name + ".bfbs", std::ios::binary);
      bytes.assign(std::istreambuf_iterator<char>(file), {});
    }
    flatbuffers::Verifier verifier(bytes.data(), bytes.size());
    if (!reflection::VerifySchemaBuffer(verifier)) std::abort();
    return *reflection::GetSchema(bytes.data());
  }

  double value(const reflection::Field& field) {
    if (field.name()->string_view() == "replay") return replay;
    return number(field.name()->string_view(), sweep, *in);
  }

  void fill(std::uint8_t* at, const reflection::Object& object, std::size_t index) {
    const std::string_view name = object.name()->string_view();
    const std::string_view kind = name.substr(name.rfind('.') + 1);
    for (const reflection::Field* field : *object.fields()) {
      fill_field(at + field->offset(), kind, *field, index);
    }
    if (kind == "Point" || kind == "MapPoint") {
      place(at, static_cast<std::size_t>(object.bytesize()), index);
    } else if (kind == "Quat") {
      const double one = 1.0;
      std::memcpy(at + 24, &one, sizeof one);
    }
  }

  /// Fills in the members of a point that differ from point to point.
  void place(std::uint8_t* at, std::size_t size, std::size_t index) const {
    float xyz[3];
    room_point(xyz, index, sweep);
    std::memcpy(at, xyz, sizeof xyz);
    if (size != sizeof(Point)) return;
    const auto time_ns = static_cast<std::uint32_t>(index / kRings * 1'000'000);
    const auto ring = static_cast<std::uint16_t>(index % kRings);
    std::memcpy(at + offsetof(Point, time_ns), &time_ns, sizeof time_ns);
    std::memcpy(at + offsetof(Point, ring), &ring, sizeof ring);
  }

  /// In a long vector every element gets the usual values; the fuzzer changes some afterwards.
  void fill_field(std::uint8_t* at, std::string_view kind, const reflection::Field& field,
                  std::size_t index) {
    const auto type = field.type()->base_type();
    const std::string_view name = field.name()->string_view();
    const auto i = static_cast<double>(index);
    if (type == BaseType::Obj) {
      fill(at, *schema->objects()->Get(static_cast<unsigned>(field.type()->index())), index);
    } else if (type == BaseType::Array) {
      const std::size_t size = size_of(field.type()->element());
      for (std::size_t k = 0; k < field.type()->fixed_length(); ++k) {
        put(at + k * size, field.type()->element(), name == "squares" ? 3.0 : 1.0);
      }
    } else if (kind == "PacketEntry" && name == "offset") {
      put(at, type, static_cast<double>(kPacket_bytes) * i);
    } else if (kind == "MapVoxel" && name.size() == 1) {
      put(at, type, name == "x" ? i : 0.0);
    } else if (name == "z" && kind == "Vec3") {
      put(at, type, 0.0);
    } else if (name.ends_with("stamp_ns")) {
      put(at, type, usual("stamp_ns", sweep) + 1e7 * i);
    } else {
      put(at, type, usual(name, sweep));
    }
  }

  /// Changes some numbers or bytes.
  void disturb(Bytes& bytes) {
    if (bytes.empty()) return;
    const std::uint8_t choice = in->byte();
    for (int left = choice < kUsual ? 0 : choice % 8; left > 0; --left) {
      const std::size_t at = (in->word() >> 32) % bytes.size();
      const std::uint8_t how = in->byte();
      if (how % 2 == 0 && bytes.size() >= 8) {
        const double value = how % 4 == 0 ? wild(*in) : static_cast<std::int8_t>(in->byte()) * .01;
        std::memcpy(bytes.data() + std::min(at / 8 * 8, bytes.size() - 8), &value, 8);
      } else {
        bytes[at] = in->byte();
      }
    }
  }

  void add_struct(flatbuffers::FlatBufferBuilder& b, const reflection::Field& field,
                  const Bytes& bytes, std::size_t align) {
    b.Align(align);
    b.PushBytes(bytes.data(), bytes.size());
    b.TrackField(field.offset(), b.GetSize());
  }

  std::string text_for(std::string_view name) {
    const std::uint8_t choice = in->byte();
    if (choice >= kNear) return in->text(40);
    if (name == "robot") return "r";
    if (name == "sensor") return "top";
    if (name == "layer") return choice % 3 == 0 ? "voxels" : choice % 3 == 1 ? "planes" : "edges";
    if (name == "values_json") return choice % 2 == 0 ? R"({"mapping.every": 2})" : "{}";
    if (name == "arguments_json") return choice % 2 == 0 ? R"({"path": "a"})" : "{}";
    if (name == "stage") return choice % 2 == 0 ? "mapping" : "odometry";
    if (name == "result_hash") return std::string(64, 'a');
    return choice % 8 == 0 ? "other" : "d";
  }

  flatbuffers::uoffset_t vector(flatbuffers::FlatBufferBuilder& b, const reflection::Field& field) {
    const reflection::Type& type = *field.type();
    const std::size_t count = count_of(field.name()->string_view(), points);
    const auto index = static_cast<unsigned>(type.index());
    if (type.element() == BaseType::Obj && !schema->objects()->Get(index)->is_struct()) {
      std::vector<flatbuffers::Offset<void>> tables;
      for (std::size_t i = 0; i < std::min<std::size_t>(count, 3); ++i) {
        tables.emplace_back(table(b, *schema->objects()->Get(index)));
      }
      return b.CreateVector(tables).o;
    }
    const bool structs = type.element() == BaseType::Obj;
    const reflection::Object* object = structs ? schema->objects()->Get(index) : nullptr;
    const auto size =
        structs ? static_cast<std::size_t>(object->bytesize()) : size_of(type.element());
    const auto align = structs ? static_cast<std::size_t>(object->minalign()) : size;
    const bool points_of_room = structs && (object->name()->string_view().ends_with("Point"));
    Bytes bytes(size * count);
    for (std::size_t i = 0; i < count; ++i) {
      const bool diagonal = count == 36 ? i % 7 == 0 : count == 144 && i % 13 == 0;
      std::uint8_t* at = bytes.data() + i * size;
      if (points_of_room && i > 0) {
        std::memcpy(at, bytes.data(), size);
        place(at, size, i);
      } else if (structs) {
        fill(at, *object, i);
      } else {
        put(at, type.element(), diagonal ? 1e-4 : 0.0);
        if (field.name()->string_view() == "data") *at = packet_byte(i, sweep);
      }
    }
    disturb(bytes);
    b.ForceVectorAlignment(count, size, align);
    b.StartVector(count, size);
    b.PushBytes(bytes.data(), bytes.size());
    return b.EndVector(count);
  }

  flatbuffers::uoffset_t table(flatbuffers::FlatBufferBuilder& b,
                               const reflection::Object& object) {
    // FlatBuffers requires that children are built before their table.
    std::map<std::uint16_t, flatbuffers::uoffset_t> children;
    std::map<std::uint16_t, Bytes> structs;
    for (const reflection::Field* field : *object.fields()) {
      const auto type = field->type()->base_type();
      // Sometimes an optional field is missing.
      if (in->byte() >= 250) continue;
      if (type == BaseType::String) {
        children[field->offset()] = b.CreateString(text_for(field->name()->string_view())).o;
      } else if (type == BaseType::Vector) {
        children[field->offset()] = vector(b, *field);
      } else if (type == BaseType::Obj) {
        const auto& child = *schema->objects()->Get(static_cast<unsigned>(field->type()->index()));
        if (!child.is_struct()) {
          children[field->offset()] = table(b, child);
        } else {
          Bytes& bytes = structs[field->offset()];
          bytes.resize(static_cast<std::size_t>(child.bytesize()));
          fill(bytes.data(), child, 0);
          disturb(bytes);
        }
      }
    }
    const auto start = b.StartTable();
    for (const reflection::Field* field : *object.fields()) {
      if (const auto child = children.find(field->offset()); child != children.end()) {
        b.AddOffset(field->offset(), flatbuffers::Offset<void>(child->second));
      } else if (const auto bytes = structs.find(field->offset()); bytes != structs.end()) {
        const auto& o = *schema->objects()->Get(static_cast<unsigned>(field->type()->index()));
        add_struct(b, *field, bytes->second, static_cast<std::size_t>(o.minalign()));
      } else if (field->type()->base_type() <= BaseType::Double) {
        Bytes scalar(size_of(field->type()->base_type()));
        put(scalar.data(), field->type()->base_type(), value(*field));
        add_struct(b, *field, scalar, scalar.size());
      }
    }
    return b.EndTable(start);
  }
};

MessageMaker::MessageMaker(const std::string& folder) : impl_(std::make_unique<Impl>()) {
  impl_->folder = folder;
}

MessageMaker::~MessageMaker() = default;

void MessageMaker::restart() { impl_->sweep = 0; }

std::vector<std::uint8_t> MessageMaker::make(const std::string& schema, Input& input) {
  static constexpr std::size_t kPoints[] = {320, 320, 320, 96, 96, 20, 1, 0};
  Impl& m = *impl_;
  m.schema = &m.load(schema);
  m.in = &input;
  // Choices for the whole message: number of points, step of the drive, replay or live.
  const std::uint8_t choice = input.byte();
  m.points = kPoints[choice % 8];
  m.sweep += choice / 8 % 4 == 0 ? 0 : 1;
  if (m.sweep <= 1) m.replay = choice >> 7;
  flatbuffers::FlatBufferBuilder b;
  b.ForceDefaults(true);
  const auto root = m.table(b, *m.schema->root_table());
  b.Finish(flatbuffers::Offset<void>(root), m.schema->file_ident()->c_str());
  Bytes bytes(b.GetBufferPointer(), b.GetBufferPointer() + b.GetSize());
  const std::uint8_t mutations = input.byte();
  for (int left = mutations < kUsual ? 0 : mutations % 8; left > 0; --left) {
    bytes[(input.word() >> 32) % bytes.size()] = input.byte();
  }
  if (mutations >= 250) bytes.resize((input.word() >> 32) % bytes.size());
  return bytes;
}

}  // namespace zloam::fuzz
