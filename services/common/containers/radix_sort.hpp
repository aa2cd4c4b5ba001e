#pragma once
// Stable sort by an unsigned integer key of known width, least significant digit first: linear in
// the number of items, and the order never depends on the machine.

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace zloam {

/// Sorts ascending by key(item), of which only the lowest `bits` count. `spare`: working memory.
template <typename Item, typename Key>
void radix_sort(std::vector<Item>& items, std::vector<Item>& spare, int bits, Key key) {
  constexpr int kDigitBits = 11;
  constexpr std::size_t kDigits = std::size_t{1} << kDigitBits;
  spare.resize(items.size());
  for (int shift = 0; shift < bits; shift += kDigitBits) {
    const auto digit = [&](const Item& item) {
      return static_cast<std::size_t>(key(item) >> shift) & (kDigits - 1);
    };
    std::array<std::uint32_t, kDigits> place{};
    for (const Item& item : items) ++place[digit(item)];
    std::uint32_t begin = 0;
    for (std::uint32_t& p : place) {
      const std::uint32_t count = p;
      p = begin;
      begin += count;
    }
    for (const Item& item : items) spare[place[digit(item)]++] = item;
    items.swap(spare);
  }
}

}  // namespace zloam
