#pragma once
// VLP-16: geometry, firing order and packet bytes. Source: Velodyne VLP-16 User Manual 63-9243,
// section 9 (packets, page numbers of revision D: 52-62) and tables 9-2 to 9-4. All multi-byte
// integers are little-endian.

#include <array>
#include <cstdint>
#include <string>

namespace zloam::simulator {

enum class ReturnMode : std::uint8_t { kStrongest = 0x37, kLast = 0x38, kDual = 0x39 };

namespace vlp16 {

inline constexpr int kLasers = 16;
inline constexpr int kBlocks = 12;
inline constexpr int kChannels = 32;  ///< per block: two firing sequences of 16 lasers
inline constexpr std::size_t kDataBytes = 1206;
inline constexpr std::size_t kPositionBytes = 512;
inline constexpr std::uint16_t kDataPort = 2368;
inline constexpr std::uint16_t kPositionPort = 8308;
inline constexpr std::uint8_t kProduct = 0x22;

inline constexpr std::int64_t kLaserNs = 2304;      ///< from one laser to the next
inline constexpr std::int64_t kSequenceNs = 55296;  ///< from one firing sequence to the next
inline constexpr std::int64_t kBlockNs = 2 * kSequenceNs;
inline constexpr double kDistanceUnitM = 0.002;
inline constexpr std::int64_t kHourNs = 3'600'000'000'000;

/// Number of data packets per position packet (manual: about 14 to 1).
inline constexpr std::int64_t kDataPerPosition = 14;

/// Elevation in degrees and height of the origin in metres, by laser.
inline constexpr std::array<double, kLasers> kElevationDeg = {-15, 1, -13, 3,  -11, 5,  -9, 7,
                                                              -7,  9, -5,  11, -3,  13, -1, 15};
inline constexpr std::array<double, kLasers> kHeightM = {
    11.2e-3, -0.7e-3, 9.7e-3, -2.2e-3, 8.1e-3, -3.7e-3, 6.6e-3, -5.1e-3,
    5.1e-3,  -6.6e-3, 3.7e-3, -8.1e-3, 2.2e-3, -9.7e-3, 0.7e-3, -11.2e-3};

/// Number of firing groups in a packet: in dual mode two blocks describe the same group.
constexpr int groups(ReturnMode mode) { return mode == ReturnMode::kDual ? kBlocks / 2 : kBlocks; }
constexpr std::int64_t packet_ns(ReturnMode mode) { return groups(mode) * kBlockNs; }

using DataBytes = std::array<std::uint8_t, kDataBytes>;
using PositionBytes = std::array<std::uint8_t, kPositionBytes>;

/// Empty packet: flags, return mode and product set, no returns.
DataBytes empty_packet(ReturnMode mode);
void set_azimuth(DataBytes& bytes, int block, double azimuth_deg);
/// counts: distance in units of 2 mm, 0 for no return.
void set_return(DataBytes& bytes, int block, int channel, std::uint16_t counts,
                std::uint8_t reflectivity);
/// unix_ns: instant of the packet's first firing; written as microseconds since the full hour.
void set_stamp(DataBytes& bytes, std::int64_t unix_ns);

enum class Pps : std::uint8_t { kNone = 0, kSynchronising = 1, kLocked = 2, kError = 3 };

/// Content of a position packet.
struct Position {
  std::int64_t unix_ns = 0;
  Pps pps = Pps::kLocked;
  double latitude_deg = 0.0;
  double longitude_deg = 0.0;
  double speed_m_s = 0.0;
  double course_deg = 0.0;  ///< clockwise from north
};
PositionBytes position_packet(const Position& position);

/// The $GPRMC sentence of the last full second (NMEA 0183), ending in CR LF.
std::string gprmc(const Position& position);

}  // namespace vlp16
}  // namespace zloam::simulator
