#pragma once
// Converts between dates of the Gregorian calendar and days since 1970-01-01 (H. Hinnant,
// "chrono-compatible low-level date algorithms", 2013).

#include <cstdint>

namespace zloam::simulator {

struct Date {
  int year;
  int month;  ///< 1 to 12
  int day;    ///< 1 to 31
};

constexpr std::int64_t days_from_date(const Date& date) {
  const std::int64_t year = date.month <= 2 ? date.year - 1 : date.year;
  const std::int64_t era = (year >= 0 ? year : year - 399) / 400;
  const std::int64_t year_of_era = year - era * 400;
  const std::int64_t month_from_march = (date.month + 9) % 12;
  const std::int64_t day_of_year = (153 * month_from_march + 2) / 5 + date.day - 1;
  return era * 146097 + year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year -
         719468;
}

constexpr Date date_from_days(std::int64_t days) {
  const std::int64_t z = days + 719468;
  const std::int64_t era = (z >= 0 ? z : z - 146096) / 146097;
  const std::int64_t day_of_era = z - era * 146097;
  const std::int64_t year_of_era =
      (day_of_era - day_of_era / 1460 + day_of_era / 36524 - day_of_era / 146096) / 365;
  const std::int64_t day_of_year =
      day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
  const std::int64_t month_from_march = (5 * day_of_year + 2) / 153;
  const auto day = static_cast<int>(day_of_year - (153 * month_from_march + 2) / 5 + 1);
  const auto month =
      static_cast<int>(month_from_march < 10 ? month_from_march + 3 : month_from_march - 9);
  return {static_cast<int>(year_of_era + era * 400) + (month <= 2 ? 1 : 0), month, day};
}

/// Whether the date exists in the calendar.
constexpr bool is_date(const Date& date) {
  if (date.month < 1 || date.month > 12 || date.day < 1) {
    return false;
  }
  const Date back = date_from_days(days_from_date(date));
  return back.year == date.year && back.month == date.month && back.day == date.day;
}

}  // namespace zloam::simulator
