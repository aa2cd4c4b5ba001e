#include "driver/ouster/profile.hpp"

#include <algorithm>

namespace zloam::driver::ouster {
namespace {

constexpr ReturnFields legacy() { return {{0, 0xFFFFF}, 4}; }
/// 19 bits of millimetres; the reflectivity is in the same word or in the next one.
constexpr ReturnFields rng19(std::uint8_t at, std::uint8_t reflectivity_at) {
  return {{at, 0x7FFFF}, reflectivity_at};
}
/// 15 bits in units of 8 mm.
constexpr ReturnFields rng15(std::uint8_t at) {
  return {{at, 0x7FFF, 3}, static_cast<std::uint8_t>(at + 2)};
}

constexpr std::array<ReturnFields, 2> single(ReturnFields fields) { return {fields, {}}; }
constexpr std::array<ReturnFields, 2> kRng19Pair = {rng19(0, 3), rng19(4, 7)};
constexpr std::array<ReturnFields, 2> kRng15Pair = {rng15(0), rng15(4)};

constexpr std::array kProfiles = {
    Profile{kLegacy, 12, 1, single(legacy())},
    Profile{"RNG19_RFL8_SIG16_NIR16", 12, 1, single(rng19(0, 4))},
    Profile{"RNG19_RFL8_SIG16_NIR16_DUAL", 16, 2, kRng19Pair},
    Profile{"RNG19_RFL8_SIG16_NIR16_ZONE16", 12, 1, single(rng19(0, 4))},
    Profile{"RNG19_RFL8_SIG16_ZONE16_DUAL", 16, 2, kRng19Pair},
    Profile{"RNG19_RFL8_SIG16_NIR16_RGB16", 16, 1, single(rng19(0, 3))},
    Profile{"RNG19_RFL8_SIG16_NIR16_RGB16_DUAL", 20, 2, kRng19Pair},
    Profile{"RNG15_RFL8_NIR8", 4, 1, single(rng15(0))},
    Profile{"RNG15_RFL8_WIN8", 4, 1, single(rng15(0))},
    Profile{"RNG15_RFL8_NIR8_ZONE16", 8, 1, single(rng15(0))},
    Profile{"RNG15_RFL8_NIR8_DUAL", 8, 2, kRng15Pair},
    Profile{"FUSA_RNG15_RFL8_NIR8_DUAL", 8, 2, kRng15Pair},
    Profile{"FIVE_WORD_PIXEL", 20, 2, kRng19Pair},
};

}  // namespace

const Profile* profile_by_name(std::string_view name) {
  const auto* found = std::find_if(kProfiles.begin(), kProfiles.end(),
                                   [&](const Profile& profile) { return profile.name == name; });
  return found == kProfiles.end() ? nullptr : &*found;
}

std::string known_profiles() {
  std::string names;
  for (const Profile& profile : kProfiles) {
    names += (names.empty() ? "" : ", ") + std::string(profile.name);
  }
  return names;
}

}  // namespace zloam::driver::ouster
