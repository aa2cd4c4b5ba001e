#include "common/runtime/run_id.hpp"

#include <openssl/evp.h>

#include <array>
#include <stdexcept>

namespace zloam::runtime {
namespace {

std::array<unsigned char, 32> sha256(std::string_view text) {
  std::array<unsigned char, 32> digest{};
  unsigned int size = 0;
  if (EVP_Digest(text.data(), text.size(), digest.data(), &size, EVP_sha256(), nullptr) != 1 ||
      size != digest.size()) {
    throw std::runtime_error("SHA-256 is not available");
  }
  return digest;
}

}  // namespace

std::string sha256_hex(std::string_view text) {
  constexpr std::string_view kDigits = "0123456789abcdef";
  std::string hex;
  for (const unsigned char byte : sha256(text)) {
    hex += kDigits[byte >> 4];
    hex += kDigits[byte & 15];
  }
  return hex;
}

std::uint64_t replay_run_id(const std::string& capture_hash,
                            const std::map<std::string, std::string>& result_hash_by_stage) {
  std::string text = "capture=" + capture_hash + "\n";
  for (const auto& [stage, hash] : result_hash_by_stage) {
    text.append(stage).append("=").append(hash).append("\n");
  }
  std::uint64_t run = 0;
  const auto digest = sha256(text);
  for (std::size_t i = 0; i < 8; ++i) run = run << 8 | digest[i];
  return run == 0 ? 1 : run;
}

}  // namespace zloam::runtime
