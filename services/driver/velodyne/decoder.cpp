#include "driver/velodyne/decoder.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <numbers>

namespace zloam::driver {
namespace {

constexpr std::size_t kBlockBytes = 100;
constexpr std::size_t kTimeAt = 1200;
constexpr std::size_t kModeAt = 1204;
constexpr std::size_t kProductAt = 1205;
constexpr int kCells = 32;
// Stamps slightly beyond the hour are seen in the field before the wrap.
constexpr std::uint32_t kMaxTohUs = 3'610'000'000U;
constexpr double kMinRpm = 180.0;
constexpr double kMaxRpm = 1500.0;
constexpr double kRadPerCdeg = std::numbers::pi / 18000.0;

std::uint16_t read_u16(const std::uint8_t* at) {
  return static_cast<std::uint16_t>(at[0] | (at[1] << 8));
}

std::uint32_t read_u32(const std::uint8_t* at) {
  return read_u16(at) | (static_cast<std::uint32_t>(read_u16(at + 2)) << 16);
}

/// Bank of lasers a block flag stands for; -1 for none.
int bank_of(const std::uint8_t* block) {
  switch (read_u16(block)) {
    case 0xEEFF:
      return 0;
    case 0xDDFF:
      return 1;
    case 0xCCFF:
      return 2;
    case 0xBBFF:
      return 3;
    default:
      return -1;
  }
}

const char* mode_name(ReturnMode mode) {
  switch (mode) {
    case ReturnMode::kStrongest:
      return "strongest";
    case ReturnMode::kLast:
      return "last";
    case ReturnMode::kDual:
      return "dual";
    default:
      return "unknown";
  }
}

std::string hex(std::uint8_t value) {
  constexpr const char* kDigits = "0123456789abcdef";
  return std::string("0x") + kDigits[value >> 4] + kDigits[value & 15];
}

// Four lanes at a time, as any 64-bit machine has them; the compiler turns this into the vector
// instructions of the target.
using Floats = float __attribute__((vector_size(16)));
using Ints = std::int32_t __attribute__((vector_size(16)));
constexpr int kLanes = 4;

Floats load(const float* at) {
  Floats values;
  std::memcpy(&values, at, sizeof values);
  return values;
}

/// A cell with one byte beyond it: raw distance, then intensity. A block is followed by another one
/// or by the packet's tail.
std::int32_t read_cell(const std::uint8_t* at) {
  std::int32_t cell;
  std::memcpy(&cell, at, sizeof cell);
  return cell;
}

/// What a block's cells have in common with those of any other block: by channel.
struct BankTables {
  const float* along;
  const float* across;
  const float* up;
  const float* height_m;
  const std::uint32_t* time_ns;
  const std::uint16_t* ring;
  const std::uint16_t* column;
};

struct Direction {
  float cos_azimuth;
  float sin_azimuth;
  float unit_m;
};

/// Position and intensity of four cells; raw 0 is no return.
struct Quad {
  std::int32_t raw[kLanes];
  Floats points[kLanes];
};

__attribute__((always_inline)) inline Quad read_quad(const std::uint8_t* cells,
                                                     const BankTables& bank, int c,
                                                     const Direction& d) {
  Quad quad;
  Ints packed;
  for (int i = 0; i < kLanes; ++i) packed[i] = read_cell(cells + 3 * (c + i));
  const Ints raw = packed & 0xFFFF;
  const Floats intensity = __builtin_convertvector((packed >> 16) & 0xFF, Floats);
  const Floats range_m = __builtin_convertvector(raw, Floats) * d.unit_m;
  const Floats along = load(bank.along + c);
  const Floats across = load(bank.across + c);
  const Floats x = range_m * (along * d.cos_azimuth - across * d.sin_azimuth);
  const Floats y = -range_m * (along * d.sin_azimuth + across * d.cos_azimuth);
  const Floats z = range_m * load(bank.up + c) + load(bank.height_m + c);
  const Floats xy_low = __builtin_shufflevector(x, y, 0, 4, 1, 5);
  const Floats xy_high = __builtin_shufflevector(x, y, 2, 6, 3, 7);
  const Floats zi_low = __builtin_shufflevector(z, intensity, 0, 4, 1, 5);
  const Floats zi_high = __builtin_shufflevector(z, intensity, 2, 6, 3, 7);
  quad.points[0] = __builtin_shufflevector(xy_low, zi_low, 0, 1, 4, 5);
  quad.points[1] = __builtin_shufflevector(xy_low, zi_low, 2, 3, 6, 7);
  quad.points[2] = __builtin_shufflevector(xy_high, zi_high, 0, 1, 4, 5);
  quad.points[3] = __builtin_shufflevector(xy_high, zi_high, 2, 3, 6, 7);
  for (int i = 0; i < kLanes; ++i) quad.raw[i] = raw[i];
  return quad;
}

/// cos and sin of whole hundredths of a degree: one table for degrees, one for the rest, and the
/// theorem of addition. Small enough to stay in the first-level cache.
class AzimuthTable {
 public:
  AzimuthTable() {
    for (int i = 0; i < 360; ++i) degrees_[i] = direction(100 * i);
    for (int i = 0; i < 100; ++i) rest_[i] = direction(i);
  }
  std::pair<double, double> cos_sin(int cdeg) const {
    const auto& [c, s] = degrees_[cdeg / 100];
    const auto& [rc, rs] = rest_[cdeg % 100];
    return {c * rc - s * rs, s * rc + c * rs};
  }

 private:
  static std::pair<double, double> direction(int cdeg) {
    return {std::cos(cdeg * kRadPerCdeg), std::sin(cdeg * kRadPerCdeg)};
  }
  std::array<std::pair<double, double>, 360> degrees_;
  std::array<std::pair<double, double>, 100> rest_;
};

const AzimuthTable& azimuth_table() {
  static const AzimuthTable kTable;
  return kTable;
}

}  // namespace

Decoder::Decoder(const DecoderConfig& config) : config_(config) {
  if (config_.model) use_model(*config_.model);
}

void Decoder::use_model(Model model) {
  table_ = &model_table(model);
  banks_ = table_->banks;
  unit_m_ = static_cast<float>(table_->distance_unit_m);
  group_ns_ = config_.group_ns > 0.0 ? config_.group_ns : table_->group_ns;
  const double stretch = group_ns_ / table_->group_ns;
  use_limits();
  single_period_ns_ = period_of(1);
  dual_period_ns_ = period_of(2);
  for (int g = 0; g < kBlocksPerPacket; ++g) {
    group_offset_ns_[g] = std::llround(g * group_ns_) + table_->first_firing_ns;
  }
  for (const Channel& channel : table_->channels) {
    const double elevation_rad = channel.elevation_deg * std::numbers::pi / 180.0;
    const double correction_rad = channel.azimuth_correction_deg * std::numbers::pi / 180.0;
    correction_cos_.push_back(std::cos(correction_rad));
    correction_sin_.push_back(std::sin(correction_rad));
    elevation_cos_.push_back(std::cos(elevation_rad));
    time_share_.push_back(channel.time_ns / table_->group_ns);
    up_.push_back(static_cast<float>(std::sin(elevation_rad)));
    height_m_.push_back(config_.vertical_offsets ? static_cast<float>(channel.vertical_offset_m)
                                                 : 0.0F);
    time_ns_.push_back(static_cast<std::uint32_t>(std::lround(stretch * channel.time_ns)));
    ring_.push_back(channel.ring);
    column_.push_back(channel.column);
  }
  along_.resize(table_->channels.size());
  across_.resize(table_->channels.size());
}

void Decoder::use_limits() {
  // A limit that is a whole number of units belongs to the range.
  const double lowest = std::ceil(config_.min_range_m / table_->distance_unit_m - 1e-6);
  const double highest = std::floor(config_.max_range_m / table_->distance_unit_m + 1e-6);
  lowest_raw_ = static_cast<std::uint32_t>(std::clamp(lowest, 1.0, 65536.0));
  const double span = std::min(highest, 65535.0) - lowest_raw_;
  raw_span_ = static_cast<std::uint32_t>(std::max(span, 0.0));
  // Nothing has so great a distance.
  if (span < 0.0) lowest_raw_ = 65536;
}

std::int64_t Decoder::period_of(int returns) const {
  return std::llround(group_ns_ * (kBlocksPerPacket / (returns * table_->banks)));
}

void Decoder::note_contradiction(bool& noted, std::string text) {
  if (!noted) contradictions_.push_back(std::move(text));
  noted = true;
}

Reject Decoder::check_model(std::uint8_t product_id) {
  const std::optional<Model> model = model_by_product_id(product_id);
  if (config_.model) {
    if (model && *model != *config_.model) {
      note_contradiction(model_noted_, "the configuration says " + std::string(table_->label) +
                                           ", the packets say " +
                                           std::string(product_label(product_id)) + " (" +
                                           hex(product_id) + "); decoded as configured");
    }
    return Reject::kNone;
  }
  if (!model) {
    note_contradiction(model_noted_, "product byte " + hex(product_id) + " (" +
                                         std::string(product_label(product_id)) +
                                         ") is no model that can be decoded; name one of " +
                                         std::string(known_model_names()) +
                                         " in the configuration");
    return Reject::kUnknownModel;
  }
  if (!table_) use_model(*model);
  return table_->model == *model ? Reject::kNone : Reject::kModelMismatch;
}

ReturnMode Decoder::check_mode(std::uint8_t mode_byte) {
  ReturnMode mode = ReturnMode::kUnknown;
  if (mode_byte == 0x37) mode = ReturnMode::kStrongest;
  if (mode_byte == 0x38) mode = ReturnMode::kLast;
  if (mode_byte == 0x39) mode = ReturnMode::kDual;
  if (!config_.return_mode) {
    if (mode == ReturnMode::kUnknown) {
      note_contradiction(mode_noted_, "return mode byte " + hex(mode_byte) +
                                          " is none of 0x37, 0x38, 0x39; name the mode in the "
                                          "configuration if the firmware has no such byte");
    }
    return mode;
  }
  if (mode != ReturnMode::kUnknown && mode != *config_.return_mode) {
    note_contradiction(mode_noted_, std::string("the configuration says return mode ") +
                                        mode_name(*config_.return_mode) + ", the packets say " +
                                        mode_name(mode) + "; decoded as configured");
  }
  return *config_.return_mode;
}

PacketTail Decoder::tail(std::span<const std::uint8_t> payload) {
  PacketTail tail;
  if (payload.size() != kDataPacketBytes) {
    const bool begins_well = payload.size() >= 2 && bank_of(payload.data()) >= 0;
    tail.reject =
        begins_well && payload.size() < kDataPacketBytes ? Reject::kShort : Reject::kForeign;
    return tail;
  }
  tail.toh_us = read_u32(payload.data() + kTimeAt);
  tail.reject = check_model(payload[kProductAt]);
  if (tail.reject != Reject::kNone) return tail;
  tail.mode = check_mode(payload[kModeAt]);
  if (tail.mode == ReturnMode::kUnknown) tail.reject = Reject::kUnknownMode;
  if (tail.toh_us > kMaxTohUs) tail.reject = Reject::kBadTime;
  return tail;
}

PacketPlan Decoder::plan(std::span<const std::uint8_t> payload, ReturnMode mode) {
  PacketPlan plan;
  plan.payload = payload.data();
  plan.toh_us = read_u32(payload.data() + kTimeAt);
  plan.mode = mode;
  const int blocks_per_group = (mode == ReturnMode::kDual ? 2 : 1) * banks_;
  plan.groups = kBlocksPerPacket / blocks_per_group;
  read_blocks(plan);
  measure_advance(plan);
  prepare_motion(plan.advance_cdeg);
  return plan;
}

void Decoder::read_blocks(PacketPlan& plan) const {
  const int blocks_per_group = (plan.mode == ReturnMode::kDual ? 2 : 1) * banks_;
  for (int g = 0; g < plan.groups; ++g) {
    Group& group = plan.group[g];
    group.offset_ns = group_offset_ns_[g];
    for (int b = 0; b < blocks_per_group; ++b) {
      const std::uint8_t* block = plan.payload + kBlockBytes * (g * blocks_per_group + b);
      const int bank = bank_of(block);
      const int azimuth_cdeg = read_u16(block + 2);
      if (bank < 0 || bank >= banks_ || azimuth_cdeg > kTurnCdeg) {
        ++plan.bad_blocks;
      } else if (!group.valid) {
        group.valid = true;
        // Sensors round up to 36000 now and then, though the manual's range ends at 35999.
        group.azimuth_cdeg = azimuth_cdeg % kTurnCdeg;
      }
    }
  }
}

// The advance is the packet's mean of plausible gaps: the motor's inertia makes it steadier than a
// single gap, whose 0.01 degree rounding it averages out. It never looks beyond the packet, so that
// a lost packet cannot smear it.
void Decoder::measure_advance(PacketPlan& plan) {
  plan.duration_ns = packet_period_ns(plan.mode);
  if (plan.groups == 1) {
    advance_by_packets(plan);
    return;
  }
  std::array<int, kBlocksPerPacket> gaps{};
  std::array<int, kBlocksPerPacket> group_after{};
  int count = 0;
  for (int g = 1; g < plan.groups; ++g) {
    if (!plan.group[g - 1].valid || !plan.group[g].valid) continue;
    group_after[count] = g;
    gaps[count++] =
        (plan.group[g].azimuth_cdeg - plan.group[g - 1].azimuth_cdeg + kTurnCdeg) % kTurnCdeg;
  }
  std::array<int, kBlocksPerPacket> sorted = gaps;
  const auto middle = sorted.begin() + count / 2;
  std::nth_element(sorted.begin(), middle, sorted.begin() + count);
  const int median = count > 0 ? *middle : 0;
  if (!plausible_advance(median)) {
    plan.advance_cdeg = last_advance_cdeg_;
    return;
  }
  double sum = 0.0;
  int plausible = 0;
  int large = 0;
  int large_at = 0;
  for (int i = 0; i < count; ++i) {
    if (gaps[i] > 0 && gaps[i] <= 2 * median) {
      sum += gaps[i];
      ++plausible;
    } else if (gaps[i] > 0 && gaps[i] < kTurnCdeg - 2 * median) {
      // Slightly backwards is jitter of the encoder; this is a gap.
      ++large;
      large_at = i;
    }
  }
  plan.advance_cdeg = sum / plausible;
  last_advance_cdeg_ = plan.advance_cdeg;
  smooth_advance(plan.advance_cdeg);
  if (large == 1 && count >= 4) pass_view_gap(plan, group_after[large_at], gaps[large_at]);
}

bool Decoder::plausible_advance(double advance_cdeg) const {
  const double rpm = advance_cdeg / (kTurnCdeg * group_ns_ * 1e-9) * 60.0;
  return rpm >= kMinRpm && rpm <= kMaxRpm;
}

// A packet of one group (128 beams, two returns) cannot tell its own advance. The motor's speed is
// taken from the stamps and azimuths of this packet and the one before: a speed, so that a lost
// packet between them does no harm.
void Decoder::advance_by_packets(PacketPlan& plan) {
  plan.advance_cdeg = last_advance_cdeg_;
  if (!plan.group[0].valid) return;
  const std::int64_t ahead_us =
      static_cast<std::int64_t>(plan.toh_us) - static_cast<std::int64_t>(last_toh_us_);
  const int turned_cdeg = (plan.group[0].azimuth_cdeg - last_azimuth_cdeg_ + kTurnCdeg) % kTurnCdeg;
  const bool known = last_azimuth_cdeg_ >= 0 && ahead_us > 0;
  last_azimuth_cdeg_ = plan.group[0].azimuth_cdeg;
  last_toh_us_ = plan.toh_us;
  if (!known) return;
  const double advance_cdeg = turned_cdeg * group_ns_ / (1e3 * static_cast<double>(ahead_us));
  const bool jump = last_advance_cdeg_ > 0.0 && advance_cdeg > 1.8 * last_advance_cdeg_;
  if (!plausible_advance(advance_cdeg) || jump) return;
  plan.advance_cdeg = advance_cdeg;
  last_advance_cdeg_ = advance_cdeg;
}

void Decoder::smooth_advance(double advance_cdeg) {
  const bool follows = std::abs(advance_cdeg - smooth_advance_cdeg_) < 0.03 * advance_cdeg;
  smooth_advance_cdeg_ =
      follows ? smooth_advance_cdeg_ + (advance_cdeg - smooth_advance_cdeg_) / 32.0 : advance_cdeg;
}

// A restricted field of view shows as one large gap forward within a packet. The sensor turned on
// meanwhile, so the groups behind the gap are later by the time it took to pass it.
void Decoder::pass_view_gap(PacketPlan& plan, int first_group, int gap_cdeg) const {
  plan.gap_before_group = first_group;
  const double skipped_groups = gap_cdeg / smooth_advance_cdeg_ - 1.0;
  const std::int64_t skipped_ns = std::llround(skipped_groups * group_ns_);
  for (int g = first_group; g < plan.groups; ++g) plan.group[g].offset_ns += skipped_ns;
  plan.duration_ns += skipped_ns;
}

void Decoder::prepare_motion(double advance_cdeg) {
  if (advance_cdeg == prepared_advance_cdeg_) return;
  prepared_advance_cdeg_ = advance_cdeg;
  const double advance_rad = advance_cdeg * kRadPerCdeg;
  for (std::size_t c = 0; c < along_.size(); ++c) {
    // At most 1 degree: the series are exact to 1e-12.
    const double a = advance_rad * time_share_[c];
    const double cos_a = 1.0 - a * a * (0.5 - a * a / 24.0);
    const double sin_a = a * (1.0 - a * a * (1.0 / 6.0 - a * a / 120.0));
    along_[c] = static_cast<float>(elevation_cos_[c] *
                                   (cos_a * correction_cos_[c] + sin_a * correction_sin_[c]));
    across_[c] = static_cast<float>(elevation_cos_[c] *
                                    (sin_a * correction_cos_[c] - cos_a * correction_sin_[c]));
  }
}

namespace {

/// Distances that count as returns; raw 0 never does.
struct RawLimits {
  std::uint32_t lowest;
  std::uint32_t span;
  bool contain(std::int32_t raw) const { return static_cast<std::uint32_t>(raw) - lowest <= span; }
};

/// Where points are written. Every cell is written and kept only when it is a return: cheaper than
/// a branch that is taken half of the time.
struct Output {
  Point* points;
  std::uint16_t* columns;
  std::size_t count = 0;

  void put(const Floats& position_and_intensity, std::uint32_t time_ns, std::uint16_t ring,
           std::uint16_t column, ReturnType type, bool keep) {
    // The two halves of a point as it lies in memory; member by member it takes twice as long.
    struct Rest {
      std::uint32_t time_ns;
      std::uint16_t ring;
      ReturnType type;
      std::uint8_t reserved;
    };
    static_assert(sizeof(Rest) == 8 && offsetof(Point, time_ns) == 16);
    const Rest rest{time_ns, ring, type, 0};
    auto* const at = reinterpret_cast<std::uint8_t*>(points + count);
    std::memcpy(at, &position_and_intensity, 16);
    std::memcpy(at + 16, &rest, sizeof rest);
    columns[count] = column;
    count += keep;
  }
};

void put_single(const std::uint8_t* block, const BankTables& bank, const Direction& direction,
                RawLimits limits, std::uint32_t time_ns, std::uint16_t column, ReturnType type,
                Output& out) {
  Output output = out;
  for (int c = 0; c < kCells; c += kLanes) {
    const Quad quad = read_quad(block + 4, bank, c, direction);
    for (int i = 0; i < kLanes; ++i) {
      output.put(quad.points[i], time_ns + bank.time_ns[c + i], bank.ring[c + i],
                 static_cast<std::uint16_t>(column + bank.column[c + i]), type,
                 limits.contain(quad.raw[i]));
    }
  }
  out.count = output.count;
}

/// Which of two returns is given, and as what.
struct Choice {
  bool last;
  bool strongest;
  ReturnType last_type;
  ReturnType strongest_type;
};

// Equal distances are one return (VLP-16 manual p. 57).
Choice choose(bool last, bool strongest, bool same, DualReturns policy) {
  const bool both = policy == DualReturns::kBoth || same;
  Choice choice{last, strongest && !same, both ? ReturnType::kBoth : ReturnType::kLast,
                both ? ReturnType::kBoth : ReturnType::kStrongest};
  if (policy == DualReturns::kStrongest && choice.strongest) choice.last = false;
  if (policy == DualReturns::kLast && choice.last) choice.strongest = false;
  return choice;
}

/// blocks[0]: even, the last returns; blocks[1]: odd, the strongest.
void put_dual(const std::uint8_t* const (&blocks)[2], const BankTables& bank,
              const Direction& direction, RawLimits limits, DualReturns policy,
              std::uint32_t time_ns, std::uint16_t column, Output& output) {
  for (int c = 0; c < kCells; c += kLanes) {
    const Quad last = read_quad(blocks[0] + 4, bank, c, direction);
    const Quad strongest = read_quad(blocks[1] + 4, bank, c, direction);
    for (int i = 0; i < kLanes; ++i) {
      const Choice choice = choose(limits.contain(last.raw[i]), limits.contain(strongest.raw[i]),
                                   last.raw[i] == strongest.raw[i], policy);
      const std::uint32_t t = time_ns + bank.time_ns[c + i];
      const std::uint16_t ring = bank.ring[c + i];
      const auto col = static_cast<std::uint16_t>(column + bank.column[c + i]);
      output.put(last.points[i], t, ring, col, choice.last_type, choice.last);
      output.put(strongest.points[i], t, ring, col, choice.strongest_type, choice.strongest);
    }
  }
}

constexpr int kMostBanks = 4;
/// Read where a pair has one good block only: no returns.
constexpr std::array<std::uint8_t, kBlockBytes + 1> kEmptyBlock{};

/// Blocks of one group by bank and return. The flag tells the bank, not the place in the packet.
using GroupBlocks = std::array<std::array<const std::uint8_t*, 2>, kMostBanks>;

GroupBlocks blocks_by_bank(const std::uint8_t* first, int banks, int returns) {
  GroupBlocks blocks{};
  for (int i = 0; i < banks * returns; ++i) {
    const std::uint8_t* block = first + kBlockBytes * static_cast<std::size_t>(i);
    const int bank = bank_of(block);
    if (bank < 0 || bank >= banks || read_u16(block + 2) > kTurnCdeg) continue;
    if (!blocks[bank][i % returns]) blocks[bank][i % returns] = block;
  }
  return blocks;
}

}  // namespace

std::size_t Decoder::decode_group(const PacketPlan& plan, int group, std::uint32_t time_ns,
                                  std::uint16_t column, Point* out, std::uint16_t* columns) const {
  const int returns = plan.mode == ReturnMode::kDual ? 2 : 1;
  const auto [cos_azimuth, sin_azimuth] = azimuth_table().cos_sin(plan.group[group].azimuth_cdeg);
  const Direction direction{static_cast<float>(cos_azimuth), static_cast<float>(sin_azimuth),
                            unit_m_};
  const ReturnType single =
      plan.mode == ReturnMode::kLast ? ReturnType::kLast : ReturnType::kStrongest;
  const RawLimits limits{lowest_raw_, raw_span_};
  const GroupBlocks by_bank = blocks_by_bank(
      plan.payload + kBlockBytes * static_cast<std::size_t>(group * banks_ * returns), banks_,
      returns);
  Output output{out, columns};
  for (int b = 0; b < banks_; ++b) {
    const std::uint8_t* blocks[2] = {by_bank[b][0], by_bank[b][1]};
    if (!blocks[0] && !blocks[1]) continue;
    const std::size_t at = static_cast<std::size_t>(b) * kCells;
    const BankTables tables{&along_[at],   &across_[at], &up_[at],    &height_m_[at],
                            &time_ns_[at], &ring_[at],   &column_[at]};
    if (returns == 1) {
      put_single(blocks[0], tables, direction, limits, time_ns, column, single, output);
      continue;
    }
    for (const std::uint8_t*& block : blocks) {
      if (!block) block = kEmptyBlock.data();
    }
    put_dual(blocks, tables, direction, limits, config_.dual_returns, time_ns, column, output);
  }
  return output.count;
}

}  // namespace zloam::driver
